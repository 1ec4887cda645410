"""The verifier of nodes and of the start of a machine: a kept proof is not repeated."""

from collections.abc import Iterator, Sequence

from im_pnt.model.groups import groups
from im_pnt.model.net import Net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.proofs import kept
from im_pnt_analysis.verify.report import Report

LOAD_LIMITS = SearchLimits(states=2_000_000, seconds=20.0)
"""Of each verification of a node or a machine that waits for it: CPU time, which a busy computer does not shorten."""


def verify_to_load(nets: Sequence[Net], limits: SearchLimits = LOAD_LIMITS) -> Report:
    """Verify nets, alone or composed, unless a proof of the unchanged nets is kept.

    Of several, only those are composed that must be (:mod:`im_pnt_analysis.verify.layers`), with nets that stand for
    those who write to their tapes.

    Raises:
        NetError: They do not fit together.

    >>> bad = parse_net("{net: bad, places: {a: 1, b: }, transitions: {go: {symbol: x, in: [a], out: [b]}}}")
    >>> print(verify_to_load([bad]).sentence)
    net bad is refused: it is stuck with b=1; siphon {a} was emptied, and can never be marked again; shown by firing go
    """

    def prove() -> Report:
        from im_pnt_analysis.verify.together import verify_in_parts  # all that searches; few starts need it

        return verify_in_parts(nets, limits, lambda text: None)

    return kept(nets, prove)


def verify_to_start(nets: Sequence[Net], limits: SearchLimits = LOAD_LIMITS) -> Iterator[Report]:
    """Verify the nets of a machine: each alone, as the node does, then communicating ones together.

    Yields:
        A report for each, the first that is refused at the end.

    Raises:
        NetError: They do not fit together.
    """
    alone = [[net] for net in nets]
    for together in (*alone, *(group for group in groups(nets) if len(group) > 1)):
        report = verify_to_load(together, limits)
        yield report
        if report.refusals:
            return
