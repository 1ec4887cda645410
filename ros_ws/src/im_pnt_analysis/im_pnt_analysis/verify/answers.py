"""Answers where the markings cannot be listed: decision diagrams, coverability, stubborn sets."""

from dataclasses import replace

from im_pnt.analysis import refusals
from im_pnt.analysis.coverability import Coverability
from im_pnt.analysis.problem import Problem
from im_pnt.analysis.report import Counterexample, Report
from im_pnt.analysis.stopping import stopping, without_marks, without_stop
from im_pnt.analysis.symbolic import Symbolic, explore

_DIAGRAMS = "decision diagrams"
_COVERABILITY = "coverability"
_STUBBORN_SETS = "stubborn sets"


def answer_from_diagrams(report: Report, problem: Problem, why: str, deadline: float) -> None:
    """Answers what decision diagrams tell.

    Args:
        report: Gets the answers and refusals.
        problem: The nets; bounded.
        why: Why the markings are not listed.
        deadline: Time on the monotonic clock at which to give up [s].
    """
    compiled = problem.compiled
    found = explore(compiled, problem.initial, deadline=deadline)
    bounds = found.place_bounds
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
        live=found.live,
        live_transitions=None if found.live_transitions is None else len(found.live_transitions),
        reversible=found.reversible,
        terminal_sccs=1 if found.reversible else None,
    )
    _never(report, _DIAGRAMS, found.never_enabled)
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


def _deadlocks(report: Report, problem: Problem, found: Symbolic, why: str) -> None:
    report.answer(_DIAGRAMS, has_deadlock=found.has_deadlock, deadlock_states=found.deadlock_states)
    for name in ("has_deadlock", "deadlock_states"):
        report.leave(f"{why}; decision diagrams: {found.unknown.get(name, '')}", name)
    dead, sequence = found.deadlock_marking, found.deadlock_sequence
    if dead is not None:
        vector = problem.compiled.marking_vector(without_marks(dead))
        refusal = refusals.deadlock(problem, without_stop(sequence or ()), vector)
        if sequence is None:
            reason = f"{refusal.reason}; no firing sequence that leads there was found in time"
            refusal = replace(refusal, reason=reason)
        report.refuse(refusal)


def answer_from_coverability(report: Report, problem: Problem, found: Coverability) -> None:
    """Answers what a coverability tree tells.

    Args:
        report: Gets the answers and refusals.
        problem: The nets.
        found: The tree.
    """
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
    _never(report, _COVERABILITY, found.never_enabled)
    if found.never_enabled:
        report.answer("a transition can never fire", live=False)


def answer_from_stubborn_sets(report: Report, problem: Problem, states: int, deadline: float) -> None:
    """Looks for a deadlock only.

    Args:
        report: Gets the answer, and the refusal.
        problem: The nets; closed.
        states: Number of markings at which to give up.
        deadline: Time on the monotonic clock at which to give up [s].
    """
    from im_pnt.analysis.stubborn import find_deadlock

    found = find_deadlock(problem.compiled, problem.initial, deadline, states)
    report.answer(_STUBBORN_SETS, has_deadlock=found.found)
    if found.found is False:
        report.answer(_STUBBORN_SETS, deadlock_states=0)
    elif found.found:
        report.refuse(refusals.deadlock(problem, found.sequence, found.marking))
        report.answer("a dead marking is reachable", live=False, live_transitions=0)
    else:
        report.leave(found.reason, "has_deadlock", "deadlock_states")


def _never(report: Report, method: str, names: tuple[str, ...] | None) -> None:
    if names is not None:
        report.answer(
            method, quasi_live=not names, never_enabled=list(names), never_enabled_transitions=len(names)
        )
