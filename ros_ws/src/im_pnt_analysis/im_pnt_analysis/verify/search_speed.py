"""Measurement of the search of markings: one half of ``scripts/im pnt bench``."""

from collections.abc import Sequence

from im_core.clock import cpu, thread_cpu
from im_pnt.model.net import Net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.structure.semiflows import p_semiflows
from im_pnt_analysis.verify.problem import problem_of


def search_speed(nets: Sequence[Net], states: int, seconds: float) -> tuple[int, float, str]:
    """Search the markings of the composition of nets.

    Args:
        nets: The nets.
        states: Largest number of markings.
        seconds: Largest CPU time [s].

    Returns:
        Number of markings found, CPU time of the search [s], and the reason of an early end, empty without one.

    Raises:
        NetError: The nets do not fit together.
    """
    problem = problem_of(nets)
    bounds = p_semiflows(problem.compiled).place_bounds(problem.compiled.places, problem.initial)
    began = cpu()
    limits = SearchLimits(states=states, seconds=seconds)
    search = Search(problem.compiled, problem.initial, bounds, kinds=problem.kinds)
    stopped = search.run(limits, thread_cpu() + seconds)
    return search.found.count, cpu() - began, stopped
