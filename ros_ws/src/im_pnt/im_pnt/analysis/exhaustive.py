"""Answers from explicit search: all of them from a finished one, some from one that was not."""

from itertools import chain, islice

from im_core.clock import monotonic
from im_pnt.analysis import refusals
from im_pnt.analysis.graph import Graph, place_bounds, stuck
from im_pnt.analysis.problem import Problem
from im_pnt.analysis.reachability import Search
from im_pnt.analysis.report import Report

REFUSED = "the nets are refused for another reason"
"""Why the return of resources is not looked at."""
EXPLICIT = "explicit breadth-first search"
_COMPONENTS = "strongly connected components of the reachability graph"
_SHOWN = 10
_GRAPH_COST = 3.0e-7
"""Time for the components, for each marking and arc [s]."""
_COLUMN_COST = 4.0e-9
"""Time for the bounds, for each marking and place [s]."""


def answer_from_whole(report: Report, problem: Problem, search: Search, deadline: float) -> None:
    """Answers everything.

    Args:
        report: Gets the answers and refusals.
        problem: The nets.
        search: Finished.
        deadline: Time on the monotonic clock at which to give up [s].
    """
    found, compiled = search.found, problem.compiled
    never = [name for name, fired in zip(compiled.transitions, found.fired, strict=True) if not fired]
    dead = stuck(search, problem.busy, may_end=problem.may_end)
    report.answer(
        EXPLICIT,
        states=found.count,
        labelled_arcs=found.labelled_arcs,
        distinct_edges=found.distinct_edges,
        bounded=True,
        unbounded_places=[],
        has_deadlock=bool(dead),
        deadlock_states=len(dead),
        quasi_live=not never,
        never_enabled=never,
        never_enabled_transitions=len(never),
    )
    _answer_bounds(report, problem, search, deadline)
    _refuse(report, problem, search, dead)
    expected = _GRAPH_COST * (found.count + found.labelled_arcs)
    if monotonic() + expected > deadline:
        report.leave(f"the components of {found.count} markings and {found.labelled_arcs} arcs would take too long")
        return
    graph = Graph(search)
    live = graph.live_transitions()
    report.answer(
        _COMPONENTS,
        live=all(live),
        live_transitions=sum(live),
        reversible=graph.reversible,
        terminal_sccs=graph.terminal_sccs,
    )
    if report.refusals:
        report.leave(REFUSED, "resources_return")
        return
    lost = chain(refusals.lost_entries(problem, found, graph, live), refusals.held_resources(problem, found, graph))
    for refusal in islice(lost, _SHOWN):
        report.refuse(refusal)
        if monotonic() > deadline:
            break
    report.answer(_COMPONENTS, resources_return=not report.refusals)


def _answer_bounds(report: Report, problem: Problem, search: Search, deadline: float) -> None:
    found, places = search.found, problem.compiled.places
    if monotonic() + _COLUMN_COST * len(places) * found.count > deadline:
        reason = f"the bounds of {len(places)} places in {found.count} markings would take too long"
        report.leave(reason, "place_bounds", "max_token_in_place", "max_token_per_marking", "safe")
        return
    bounds, most_in_marking = place_bounds(found)
    most = max(bounds, default=0)
    report.answer(
        EXPLICIT,
        place_bounds=dict(zip(places, bounds, strict=True)),
        max_token_in_place=most,
        max_token_per_marking=most_in_marking,
        safe=most <= 1,
    )


def answer_from_part(report: Report, problem: Problem, search: Search, deadline: float) -> None:
    """Answers what some of the markings tell: what was found is there, whatever else is.

    Args:
        report: Gets the answers and refusals.
        problem: The nets.
        search: Not finished.
        deadline: Time on the monotonic clock at which to give up [s].
    """
    found = search.found
    method = f"{EXPLICIT} of some markings"
    dead = stuck(search, problem.busy, may_end=problem.may_end)
    if dead:
        report.answer(method, has_deadlock=True)
        if problem.closed and problem.compiled.transitions:
            report.answer("a dead marking is reachable", live=False, live_transitions=0, reversible=dead != [0])
    if monotonic() + _COLUMN_COST * len(problem.initial) * found.count < deadline:
        bounds, _ = place_bounds(found)
        if max(bounds, default=0) > 1:
            report.answer(method, safe=False)
    if found.fired.all():
        report.answer(method, quasi_live=True, never_enabled=[], never_enabled_transitions=0)
    _refuse(report, problem, search, dead)


def _refuse(report: Report, problem: Problem, search: Search, dead: list[int]) -> None:
    overflow = refusals.overflow(problem, search.found)
    if overflow is not None:
        report.refuse(overflow)
    if dead:
        found = search.found
        report.refuse(refusals.deadlock(problem, found.sequence(dead[0]), found.vector(dead[0])))
