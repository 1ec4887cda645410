"""The verifier of nodes and of the start of a machine: what was proved before is not proved again."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from im_pnt.model.groups import groups
from im_pnt.model.net import Net
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.search.reachability import SearchLimits
from im_pnt_analysis.verify.answers import answer_holding
from im_pnt_analysis.verify.layers import parts
from im_pnt_analysis.verify.proofs import Proofs
from im_pnt_analysis.verify.report import NEEDED, Report
from im_pnt_analysis.verify.verdict import Progress, verify

LOAD_LIMITS = SearchLimits(states=2_000_000, seconds=20.0)
"""Of each verification of a node or a machine that waits for it: CPU time, which a busy computer does not shorten."""


def verify_to_load(
    nets: Sequence[Net], limits: SearchLimits = LOAD_LIMITS, progress: Progress = lambda text: None
) -> Report:
    """Verifies nets, alone or composed, unless they were verified before and are unchanged.

    Of several, only those are composed that must be (:mod:`im_pnt_analysis.verify.layers`), with nets that stand for
    those who write to their tapes.

    Args:
        nets: Nets as written.
        limits: Where the search gives up.
        progress: Is told what goes on.

    Raises:
        NetError: They do not fit together.
    """

    def prove() -> Report:
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
        joined = _joined(nets, [_kept(part, proof) for part, proof in zip(together, proofs, strict=True)])
        answer_holding(joined, nets, limits.seconds)
        joined.decide()
        return joined

    return _kept(nets, prove)


def _kept(nets: Sequence[Net], prove: Callable[[], Report]) -> Report:
    """Returns what was proved of nets before, or what is now."""
    proofs = Proofs()
    report = proofs.find(nets)
    if report is None:
        report = prove()
        report.composed = report.composed or list(nets)
        if report.ok:
            proofs.keep(nets, report)
    return report


def _joined(nets: Sequence[Net], reports: Sequence[Report]) -> Report:
    """Returns the verdict on nets whose parts were verified.

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


def verify_to_start(
    nets: Sequence[Net], limits: SearchLimits = LOAD_LIMITS, progress: Progress = lambda text: None
) -> Iterator[Report]:
    """Verifies the nets of a machine: each alone, as its node does, then those that talk to each other together.

    Args:
        nets: All nets of the machine, as written.
        limits: Where each search gives up.
        progress: Is told what goes on.

    Yields:
        A report for each, the first that is refused at the end.

    Raises:
        NetError: They do not fit together.
    """
    alone = [[net] for net in nets]
    for together in (*alone, *(group for group in groups(nets) if len(group) > 1)):
        report = verify_to_load(together, limits, progress)
        yield report
        if report.refusals:
            return
