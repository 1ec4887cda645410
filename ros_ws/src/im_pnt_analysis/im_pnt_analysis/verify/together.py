"""Proof of nets: alone, or composed as far as needed."""

from collections.abc import Sequence
from functools import partial

from im_core.clock import monotonic, thread_cpu
from im_pnt.model.groups import groups, nets_by_name
from im_pnt.model.net import Net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.answers import answer_holding, conserve, describe
from im_pnt_analysis.verify.layers import parts
from im_pnt_analysis.verify.problem import problem_of
from im_pnt_analysis.verify.proofs import fingerprint, keep_proof, kept
from im_pnt_analysis.verify.report import NEEDED, Progress, Report
from im_pnt_analysis.verify.verdict import ALL_ROWS, verify


def verify_files(nets: Sequence[Net], limits: SearchLimits, *, structure: bool, progress: Progress) -> Report:
    """Verify nets as the start of a machine does: each alone, then together; the answers are all computed.

    Args:
        nets: Nets as written.
        limits: Where each search gives up.
        structure: Whether to find T-semiflows, siphons and traps, too, of nets that are composed.
        progress: Is told what goes on.

    Returns:
        The verdict on the nets together; on one of them, if that is refused, or not proved, alone.

    Raises:
        NetError: They do not fit together.
    """
    began, used = monotonic(), thread_cpu()
    nets_by_name(nets)
    if len(nets) > 1:
        alone = [kept([net], partial(verify, [net], limits, progress=progress)) for net in nets]
        failing = [report for report in alone if report.refusals] or [report for report in alone if not report.ok]
        if failing:
            return failing[0]
    report = verify_in_parts(nets, limits, progress, structure=structure)
    if structure and report.p_semiflows is None:
        progress("semiflows, siphons and traps of all nets together")
        problem = problem_of(nets)
        conserve(report, problem, thread_cpu() + limits.seconds, ALL_ROWS)
        describe(report, problem, thread_cpu() + limits.seconds)
    report.time_s, report.cpu_s = round(monotonic() - began, 4), round(thread_cpu() - used, 4)
    if report.ok and len(groups(nets)) == 1:
        keep_proof(nets, fingerprint(nets), report)
    return report


def verify_in_parts(
    nets: Sequence[Net], limits: SearchLimits, progress: Progress, *, structure: bool = False
) -> Report:
    """Verify nets, alone or composed, as :func:`im_pnt_analysis.verify.load.verify_to_load` does without a kept proof.

    Args:
        nets: Nets as written.
        limits: Where the search gives up.
        progress: Is told what goes on.
        structure: Whether to find T-semiflows, siphons and traps, too, of nets that are composed.

    Raises:
        NetError: They do not fit together.
    """
    divided = parts(nets, limits) if len(nets) > 1 else [list(nets)]
    if len(divided) == 1:
        return verify(nets, limits, structure=structure, progress=progress)
    from im_pnt_analysis.composition.callers import Callers  # brings a library that few nodes need

    callers = Callers(nets)
    standing = [callers.of(part) for part in divided]
    if None in standing:
        return verify(nets, limits, structure=structure, progress=progress)
    together = [[*part, *(others or ())] for part, others in zip(divided, standing, strict=True)]
    proofs = [
        partial(verify, part, limits, holding=not others, progress=progress)
        for part, others in zip(together, standing, strict=True)
    ]
    joined = _joined(nets, [kept(part, proof) for part, proof in zip(together, proofs, strict=True)])
    answer_holding(joined, nets, limits.seconds)
    joined.decide()
    return joined


def _joined(nets: Sequence[Net], reports: Sequence[Report]) -> Report:
    """Return the verdict on nets with verified parts.

    Raises:
        NetError: The nets do not fit together.
    """
    joined = Report([net.name for net in nets], assumptions=list(problem_of(nets).composition.assumptions))
    method = f"{len(reports)} parts, each verified by itself: what one asks of another is always answered"
    for name in NEEDED.keys() - {"resources_held"}:  # which only all nets together tell
        answers = [getattr(report, name) for report in reports]
        joined.answer(method, **{name: None if None in answers else _all(name, answers)})
    if all(report.states is not None for report in reports):
        joined.answer(method, states=sum(report.states or 0 for report in reports))
    for report in reports:
        for name, why in report.unknown.items():
            joined.leave(f"{'+'.join(report.nets)}: {why}", name)
        joined.refusals += report.refusals
        if report.refusals:
            joined.composed = joined.composed or report.composed
    joined.leave("not asked of parts")
    joined.time_s = round(sum(report.time_s for report in reports), 4)
    joined.cpu_s = round(sum(report.cpu_s for report in reports), 4)
    return joined


def _all(name: str, answers: Sequence[bool]) -> bool:
    return any(answers) if name == "has_deadlock" else all(answers)
