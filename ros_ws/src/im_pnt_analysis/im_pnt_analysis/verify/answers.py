"""How each method answers: structure, explicit search, decision diagrams, coverability, stubborn sets."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, islice

import numpy as np

from im_core.clock import thread_cpu
from im_pnt.execution.jobs import DONE_SUFFIX
from im_pnt.model.expand import expand
from im_pnt.model.net import Net
from im_pnt.verification import Counterexample
from im_pnt_analysis.composition.resource_proof import UndecidedError, unheld
from im_pnt_analysis.search.coverability import Coverability
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.search.reachability_graph import ReachabilityGraph, place_bounds, stuck
from im_pnt_analysis.search.stubborn import find_deadlock
from im_pnt_analysis.structure.semiflows import p_semiflows, t_semiflows
from im_pnt_analysis.symbolic.exploration import SymbolicAnswers, explore
from im_pnt_analysis.verify import counterexamples
from im_pnt_analysis.verify.problem import DOES, Problem, stopping, without_marks, without_stop
from im_pnt_analysis.verify.report import NOTHING_ACTS, Report


def answer_holding(report: Report, nets: Sequence[Net], seconds: float) -> None:
    """Decide whether every user of a resource holds the resource.

    Args:
        report: Gets the answer and refusals.
        nets: The nets, as written.
        seconds: CPU time at which to give up [s].
    """
    try:
        cases = unheld(nets, thread_cpu() + seconds)
    except UndecidedError as error:
        report.leave(str(error), "resources_held")
        return
    for case in cases or ():
        report.refuse(case)
    method = NOTHING_ACTS if cases is None else "the ways of the tokens of each command and request"
    report.answer(method, resources_held=not cases)


_FARKAS = "Farkas' algorithm"
_SHARE = 0.08


def conserve(report: Report, problem: Problem, deadline: float, max_rows: int) -> list[int | None]:
    """Find the P-semiflows and the bounds.

    Args:
        report: Gets the answers.
        problem: The nets.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which everything ends [s].
        max_rows: Rows of the working table at which to leave some out; every place that can be is covered all the same.

    Returns:
        For each place a proved bound, None where there is none.
    """
    flows = p_semiflows(problem.compiled, max_rows, _share(deadline))
    report.answer(_FARKAS, p_semiflows=list(flows.flows), p_semiflows_complete=flows.complete)
    bounds = flows.place_bounds(problem.compiled.places, problem.initial)
    if all(bound is not None for bound in bounds):
        report.answer("every place is in a P-semiflow", bounded=True, unbounded_places=[])
    return bounds


def solve_bounds(report: Report, problem: Problem, deadline: float) -> None:
    """Search for bounds by linear programming.

    Args:
        report: Gets the answer, if all places are bounded.
        problem: The nets.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].
    """
    from im_pnt_analysis.structure.state_equation import structurally_bounded

    if structurally_bounded(problem.compiled, deadline):
        report.answer("linear programming: a weighting that no firing raises", bounded=True, unbounded_places=[])


def describe(report: Report, problem: Problem, deadline: float) -> None:
    """Find T-semiflows, siphons and traps.

    Args:
        report: Gets the answers.
        problem: The nets.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which everything ends [s].
    """
    from im_pnt_analysis.structure.siphons import siphons, traps

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
    now = thread_cpu()
    return now + _SHARE * max(0.0, deadline - now)


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
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].
    """
    found, ways = search.found, problem.ways
    if _stopped(report, problem, search):
        return
    never = [name for name, numbers in ways.items() if not any(found.fired[number] for number in numbers)]
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
    expected = _GRAPH_COST * (found.count + found.labelled_arcs)  # components have no deadline: ask beforehand
    if thread_cpu() + expected > deadline:
        report.leave(f"the components of {found.count} markings and {found.labelled_arcs} arcs would take too long")
        return
    graph = ReachabilityGraph(search)
    live = graph.live_transitions()
    own = [counterexamples.lives(graph, live, numbers) for numbers in ways.values()]
    report.answer(
        _COMPONENTS,
        live=all(own),
        live_transitions=sum(own),
        reversible=graph.reversible,
        terminal_sccs=graph.terminal_sccs,
    )
    for refusal in counterexamples.unpaid_debts(problem, found, graph):
        report.refuse(refusal)
    if report.refusals:
        report.leave(REFUSED, "resources_return")
        return
    lost = chain(  # lazily: a counterexample is searched only when it is shown
        counterexamples.lost_entries(problem, found, graph, live),
        counterexamples.held_resources(problem, found, graph),
    )
    for refusal in islice(lost, _SHOWN):
        report.refuse(refusal)
        if thread_cpu() > deadline:
            break
    report.answer(_COMPONENTS, resources_return=not report.refusals)


def answer_rest(report: Report, problem: Problem, search: Search) -> None:
    """Answer whether a net is back in the first marking whenever it does nothing by itself.

    Args:
        report: Gets the answer.
        problem: One net.
        search: Finished.
    """
    found, own = search.found, expand(problem.nets[0]).places
    quiet = found.words[:, np.flatnonzero((found.kinds[: found.count] & DOES) == 0)]
    rests = True
    for index, place in enumerate(problem.compiled.places):
        if rests and place in own:
            tokens = problem.initial[index]
            rests = not found.packing.holds(quiet, index, tokens + 1).any()
            rests = rests and (not tokens or bool(found.packing.holds(quiet, index, tokens).all()))
    report.answer(EXPLICIT, comes_to_rest=rests)


_BEYOND = "a place that a transition empties exceeds its capacity, beyond which nothing is looked at"


def _stopped(report: Report, problem: Problem, search: Search) -> bool:
    """Refuse nets with an emptied place beyond the capacity; return whether there is one."""
    overflow = counterexamples.overflow(problem, search.found, emptied=True)
    if overflow is not None:
        report.refuse(overflow)
        report.leave(_BEYOND)
    return overflow is not None


def _answer_bounds(report: Report, problem: Problem, search: Search, deadline: float) -> None:
    found, places = search.found, problem.compiled.places
    if thread_cpu() + _COLUMN_COST * len(places) * found.count > deadline:
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
    """Answer by some of the markings: the findings stand.

    Args:
        report: Gets the answers and refusals.
        problem: The nets.
        search: Not finished.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].
    """
    found = search.found
    if _stopped(report, problem, search):
        return
    method = f"{EXPLICIT} of some markings"
    dead = stuck(search, problem.busy, may_end=problem.may_end)
    if dead:
        report.answer(method, has_deadlock=True)
        if problem.closed and problem.compiled.transitions:
            report.answer("a dead marking is reachable", live=False, live_transitions=0, reversible=dead == [0])
    if thread_cpu() + _COLUMN_COST * len(problem.initial) * found.count < deadline:
        bounds, _ = place_bounds(found)
        if max(bounds, default=0) > 1:
            report.answer(method, safe=False)
    if all(any(found.fired[number] for number in numbers) for numbers in problem.ways.values()):
        report.answer(method, quasi_live=True, never_enabled=[], never_enabled_transitions=0)
    _refuse(report, problem, search, dead)


def _refuse(report: Report, problem: Problem, search: Search, dead: list[int]) -> None:
    overflow = counterexamples.overflow(problem, search.found)
    if overflow is not None:
        report.refuse(overflow)
    if dead:
        found = search.found
        report.refuse(counterexamples.deadlock(problem, found.sequence(dead[0]), found.vector(dead[0])))


_DIAGRAMS = "decision diagrams"
_COVERABILITY = "coverability"
_STUBBORN_SETS = "stubborn sets"


def answer_from_diagrams(report: Report, problem: Problem, why: str, deadline: float) -> None:
    """Answer by decision diagrams.

    Args:
        report: Gets the answers and refusals.
        problem: The nets; bounded.
        why: Why the markings are not listed.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].
    """
    compiled = problem.compiled
    found = explore(compiled, problem.initial, deadline=deadline)
    live = _live(problem, found)
    bounds = found.place_bounds
    if bounds is not None and problem.is_beyond(bounds):
        report.answer(_DIAGRAMS, place_bounds=bounds)
        refuse_overflow(report, problem)
        report.leave(_BEYOND)
        return
    most = None if bounds is None else max(bounds.values(), default=0)
    report.answer(
        _DIAGRAMS,
        states=found.states,
        labelled_arcs=found.arcs,
        distinct_edges=found.distinct_edges,
        place_bounds=bounds,
        max_token_in_place=most,
        max_token_per_marking=found.max_token_per_marking,
        bounded=None if bounds is None else True,
        unbounded_places=None if bounds is None else [],
        safe=None if most is None else most <= 1,
        live=found.live if live is None else len(live) == len(problem.ways),
        live_transitions=None if live is None else len(live),
        reversible=found.reversible,
        terminal_sccs=1 if found.reversible else None,
    )
    _never(report, problem, _DIAGRAMS, found.never_enabled)
    if found.reversible:
        report.answer("the initial marking can always be reached again", resources_return=True)
    elif found.reversible is False:
        report.leave("not obtained from decision diagrams", "terminal_sccs")
        report.leave("not obtained from decision diagrams", "resources_return")
    for name, reason in found.unknown.items():
        if name in Report.__slots__ and name not in ("has_deadlock", "deadlock_states"):
            report.leave(f"{why}; decision diagrams: {reason}", name)
    if not problem.closed:
        found = explore(*stopping(problem), deadline=deadline)
    _deadlocks(report, problem, found, why)


def _live(problem: Problem, found: SymbolicAnswers) -> list[str] | None:
    """Return the live transitions; None where unknown.

    One of whose ways each may end for ever may live all the same, as long as another is left; who goes back to the
    beginning always lives if it ever fires.
    """
    if found.live_transitions is None:
        return None
    alive = {*found.live_transitions}
    named = problem.compiled.transitions
    live = [name for name, numbers in problem.ways.items() if any(named[number] in alive for number in numbers)]
    split = len(problem.ways) + len(problem.composition.watching) < len(named)
    return None if split and not found.reversible and len(live) < len(problem.ways) else live


def _deadlocks(report: Report, problem: Problem, found: SymbolicAnswers, why: str) -> None:
    if found.deadlock_marking is not None and problem.is_beyond(found.deadlock_marking):
        report.leave(_BEYOND, "has_deadlock", "deadlock_states")
        return
    report.answer(_DIAGRAMS, has_deadlock=found.has_deadlock, deadlock_states=found.deadlock_states)
    for name in ("has_deadlock", "deadlock_states"):
        report.leave(f"{why}; decision diagrams: {found.unknown.get(name, '')}", name)
    dead, sequence = found.deadlock_marking, found.deadlock_sequence
    if dead is not None:
        vector = problem.compiled.marking_vector(without_marks(dead))
        refusal = counterexamples.deadlock(problem, without_stop(sequence or ()), vector)
        if sequence is None:
            reason = f"{refusal.reason}; no firing sequence that leads there was found in time"
            refusal = replace(refusal, reason=reason)
        report.refuse(refusal)


def answer_from_coverability(report: Report, problem: Problem, found: Coverability) -> None:
    """Answer by a coverability tree."""
    compiled = problem.compiled
    report.answer(_COVERABILITY, bounded=found.bounded)
    if found.bounded is False:
        vector = problem.initial
        for name in (*found.sequence, *found.repeat):
            vector = compiled.fire(vector, compiled.transitions.index(name))
        report.refuse(
            Counterexample(
                "growth",
                f"place {', '.join(found.growing)} can grow without end",
                found.sequence,
                compiled.marking(vector),
                found.repeat,
            )
        )
    if not found.complete:
        report.leave(found.reason, "bounded", "place_bounds", "unbounded_places")
        report.leave(found.reason, "quasi_live", "never_enabled", "never_enabled_transitions")
        return
    bounds: dict[str, int | None] = dict.fromkeys(compiled.places)
    bounds.update(found.place_bounds or {})
    report.answer(_COVERABILITY, unbounded_places=list(found.unbounded_places), place_bounds=bounds)
    _never(report, problem, _COVERABILITY, found.never_enabled)
    if report.never_enabled:
        report.answer("a transition can never fire", live=False)


def answer_from_stubborn_sets(report: Report, problem: Problem, states: int, deadline: float) -> None:
    """Search for a deadlock only.

    Args:
        report: Gets the answer, and the refusal.
        problem: The nets; closed.
        states: Number of markings at which to give up.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].
    """
    found = find_deadlock(problem.compiled, problem.initial, deadline, states)
    if found.found and problem.is_beyond(problem.compiled.marking(found.marking)):
        report.leave(_BEYOND, "has_deadlock", "deadlock_states")
        return
    report.answer(_STUBBORN_SETS, has_deadlock=found.found)
    if found.found is False:
        report.answer(_STUBBORN_SETS, deadlock_states=0)
    elif found.found:
        report.refuse(counterexamples.deadlock(problem, found.sequence, found.marking))
        report.answer("a dead marking is reachable", live=False, live_transitions=0)
    else:
        report.leave(found.reason, "has_deadlock", "deadlock_states")


def _never(report: Report, problem: Problem, method: str, found: tuple[str, ...] | None) -> None:
    if found is not None:
        disabled, named = {*found}, problem.compiled.transitions
        names = [name for name, ways in problem.ways.items() if all(named[way] in disabled for way in ways)]
        report.answer(method, quasi_live=not names, never_enabled=names, never_enabled_transitions=len(names))


def refuse_endless(report: Report, problem: Problem) -> None:
    """Refuse a command that can begin and can never end well: nothing enables a transition that acknowledges it.

    Args:
        report: Has the transitions that are never enabled, if they were found; gets the refusals.
        problem: The nets.
    """
    never, ways = {*(report.never_enabled or ())}, problem.composition.ways
    named = [(ways.get(each.name, each.name), each) for each in problem.compiled.net.transitions.values()]
    for symbol in dict.fromkeys(symbol for net in problem.nets for symbol in net.begun_symbols()):
        ends = {name for name, each in named if f"{symbol}{DONE_SUFFIX}" in each.emit}
        begins = {name for name, each in named if each.symbol == symbol}
        if ends and ends <= never and begins - never:
            reason = f"command {symbol} never ends well: nothing enables {', '.join(sorted(ends))}"
            report.refuse(Counterexample("lost_command", reason, (), {}))


def refuse_overflow(report: Report, problem: Problem) -> None:
    """Refuse a place with more tokens than the capacity, with the number but without a firing sequence.

    Args:
        report: Has the bounds of the places, if they were found; gets the refusals.
        problem: The nets.
    """
    for name, most in (report.place_bounds or {}).items():
        capacity = problem.compiled.net.places[name].capacity
        if capacity is not None and most is not None and most > capacity:
            reason = counterexamples.too_many(problem, name, most)
            kind = "assumption" if name in problem.composition.promises else "overflow"
            unknown = f"{reason}; no firing sequence that leads there was found in time"
            report.refuse(Counterexample(kind, unknown, (), {}))
