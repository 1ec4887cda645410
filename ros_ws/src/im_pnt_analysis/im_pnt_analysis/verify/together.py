"""Proof of nets: alone, or composed as far as needed."""

from collections.abc import Sequence
from functools import partial

from im_pnt.model.net import Net
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.answers import answer_holding
from im_pnt_analysis.verify.layers import parts
from im_pnt_analysis.verify.proofs import kept
from im_pnt_analysis.verify.report import NEEDED, Progress, Report
from im_pnt_analysis.verify.verdict import verify


def verify_in_parts(nets: Sequence[Net], limits: SearchLimits, progress: Progress) -> Report:
    """Verify nets, alone or composed, as :func:`im_pnt_analysis.verify.load.verify_to_load` does without a kept proof.

    Args:
        nets: Nets as written.
        limits: Where the search gives up.
        progress: Is told what goes on.

    Raises:
        NetError: They do not fit together.
    """
    divided = parts(nets) if len(nets) > 1 else [list(nets)]
    if len(divided) == 1:
        return verify(nets, limits, progress=progress)
    from im_pnt_analysis.composition.callers import callers  # brings a library that few nodes need

    standing = [callers(part, nets) for part in divided]
    if None in standing:
        return verify(nets, limits, progress=progress)
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
    joined = Report([net.name for net in nets], assumptions=list(compose(nets).assumptions))
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
