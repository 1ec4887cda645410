"""What the structure of a net tells: semiflows, bounds proved by them, siphons and traps."""

from collections.abc import Mapping

from im_core.clock import monotonic
from im_pnt.analysis.problem import Problem
from im_pnt.analysis.report import Report
from im_pnt.analysis.semiflows import Semiflows, p_semiflows, t_semiflows

_FARKAS = "Farkas' algorithm"
_SHARE = 0.08


def invariant_bounds(problem: Problem, flows: Semiflows) -> list[int | None]:
    """Returns for each place the bound that P-semiflows prove; None: none."""
    number = {name: index for index, name in enumerate(problem.compiled.places)}
    bounds: list[int | None] = [None] * len(number)
    for flow in flows.flows:
        weights: Mapping[int, int] = {number[name]: weight for name, weight in flow.items()}
        total = sum(weight * problem.initial[place] for place, weight in weights.items())
        for place, weight in weights.items():
            bound = bounds[place]
            bounds[place] = total // weight if bound is None else min(bound, total // weight)
    return bounds


def conserve(report: Report, problem: Problem, deadline: float, max_rows: int) -> list[int | None]:
    """Finds the P-semiflows and what they bound.

    Args:
        report: Gets the answers.
        problem: The nets.
        deadline: Time on the monotonic clock at which everything ends [s].
        max_rows: Rows of the working table at which to leave some out; every place that can be is covered all the same.

    Returns:
        For each place a proved bound, None where there is none.
    """
    flows = p_semiflows(problem.compiled, max_rows, _share(deadline))
    report.answer(_FARKAS, p_semiflows=list(flows.flows), p_semiflows_complete=flows.complete)
    bounds = invariant_bounds(problem, flows)
    if all(bound is not None for bound in bounds):
        report.answer("every place is in a P-semiflow", bounded=True, unbounded_places=[])
    return bounds


def solve_bounds(report: Report, problem: Problem, deadline: float) -> None:
    """Looks for bounds by linear programming.

    Args:
        report: Gets the answer, if all places are bounded.
        problem: The nets.
        deadline: Time on the monotonic clock at which to give up [s].
    """
    from im_pnt.analysis.bounds import structurally_bounded

    if structurally_bounded(problem.compiled, deadline):
        report.answer("linear programming: a weighting that no firing raises", bounded=True, unbounded_places=[])


def describe(report: Report, problem: Problem, deadline: float) -> None:
    """Finds T-semiflows, siphons and traps.

    Args:
        report: Gets the answers.
        problem: The nets.
        deadline: Time on the monotonic clock at which everything ends [s].
    """
    from im_pnt.analysis.siphons import siphons, traps

    flows = t_semiflows(problem.compiled, deadline=_share(deadline))
    report.answer(_FARKAS, t_semiflows=list(flows.flows), t_semiflows_complete=flows.complete)
    found = siphons(problem.compiled, deadline=_share(deadline))
    sets = [list(names) for names in found.sets]
    report.answer(_solver(found.reason), siphons=sets, siphons_complete=found.complete)
    found = traps(problem.compiled, deadline=_share(deadline))
    sets = [list(names) for names in found.sets]
    report.answer(_solver(found.reason), traps=sets, traps_complete=found.complete)


def _solver(reason: str) -> str:
    return f"satisfiability, stopped: {reason}" if reason else "satisfiability"


def _share(deadline: float) -> float:
    now = monotonic()
    return now + _SHARE * max(0.0, deadline - now)
