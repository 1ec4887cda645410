"""The verdict on one net or several: may it run, and if not, the shortest firing sequence that shows why."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from im_core.clock import monotonic
from im_pnt.analysis.compose import Composition, compose
from im_pnt.analysis.reachability import Graph, Limits, at_rest_test, explore
from im_pnt.analysis.semiflows import p_semiflows
from im_pnt.compiled import compile_net
from im_pnt.errors import VerificationError
from im_pnt.net import Net, Role


@dataclass(frozen=True, slots=True)
class Counterexample:
    """What goes wrong, and the shortest way there.

    Attributes:
        reason: One sentence.
        sequence: Transitions to fire from the initial marking.
        marking: Marked places where it goes wrong.
        repeat: Transitions that can be repeated for ever after the sequence (unbounded nets).
    """

    reason: str
    sequence: tuple[str, ...]
    marking: dict[str, int]
    repeat: tuple[str, ...] = ()


@dataclass(slots=True)
class Report:
    """Answers about a composition; None where the search did not get that far, with the reason in ``unknown``.

    Attributes:
        nets: Names of the nets.
        ok: Whether the net may run.
        states: Markings found.
        labelled_arcs: Firings found.
        bounded: Whether no place can grow without end.
        safe: Whether no place ever holds two tokens.
        max_token_in_place: Most tokens a place ever holds.
        max_token_per_marking: Most tokens of a marking.
        place_bounds: Most tokens of each place.
        has_deadlock: Whether it can get stuck, resting and waiting for a symbol or request excepted.
        never_enabled_transitions: Transitions that can never fire.
        p_semiflows: Weightings of places that never change.
        p_semiflows_complete: Whether these are all of minimal support.
        refusals: What forbids to run it.
        assumptions: What the verdicts take for granted.
        unknown: For each answer that is missing the reason.
        method: How the answers were obtained.
        time_s: How long it took [s].
    """

    nets: list[str]
    ok: bool = False
    states: int = 0
    labelled_arcs: int = 0
    bounded: bool | None = None
    safe: bool | None = None
    max_token_in_place: int | None = None
    max_token_per_marking: int | None = None
    place_bounds: dict[str, int] | None = None
    has_deadlock: bool | None = None
    never_enabled_transitions: list[str] | None = None
    p_semiflows: list[dict[str, int]] = field(default_factory=list)
    p_semiflows_complete: bool = False
    refusals: list[Counterexample] = field(default_factory=list)
    assumptions: list[str] = field(default_factory=list)
    unknown: dict[str, str] = field(default_factory=dict)
    method: str = ""
    time_s: float = 0.0

    def to_dict(self) -> dict[str, object]:
        """Returns the report as plain data."""
        return asdict(self)

    def require_ok(self) -> None:
        """Accepts or refuses.

        Raises:
            VerificationError: The net must not run; carries the shortest firing sequence that shows why.
        """
        name = "+".join(self.nets)
        for refusal in self.refusals:
            raise VerificationError(name, refusal.reason, refusal.sequence + refusal.repeat)
        if not self.ok:
            why = "; ".join(f"{answer} is unknown ({reason})" for answer, reason in self.unknown.items())
            raise VerificationError(name, why)


def verify(nets: Sequence[Net], limits: Limits | None = None) -> Report:
    """Verifies one net, or several joined over remote places and coordination structures.

    Args:
        nets: The nets.
        limits: Where the search gives up.

    Raises:
        NetError: The nets do not fit together.
    """
    begin = monotonic()
    composition = compose(nets)
    compiled = compile_net(composition.net)
    flows = p_semiflows(compiled)
    covered = flows.covers(compiled.places)
    graph = explore(composition, limits, bounded=covered)
    report = Report([net.name for net in nets], states=len(graph.states), assumptions=list(composition.assumptions))
    report.p_semiflows, report.p_semiflows_complete = list(flows.flows), flows.complete
    report.method = "explicit breadth-first search" + (", bounded by P-semiflows" if covered else "")
    report.labelled_arcs = sum(len(arcs) for arcs in graph.arcs)
    _bounds(report, graph, covered)
    _deadlock(report, graph, composition)
    _dead_transitions(report, graph)
    if graph.complete and not report.refusals:
        _lost_entries(report, graph, composition)
    report.ok = bool(report.bounded and report.has_deadlock is False and graph.complete and not report.refusals)
    report.time_s = round(monotonic() - begin, 4)
    return report


def _bounds(report: Report, graph: Graph, covered: bool) -> None:
    compiled = graph.compiled
    if graph.growth is not None:
        earlier, later = graph.growth
        grown = [
            name
            for name, a, b in zip(compiled.places, graph.states[earlier], graph.states[later], strict=True)
            if b > a
        ]
        report.bounded = report.safe = False
        report.refusals.append(
            Counterexample(
                f"place {', '.join(grown)} can grow without end",
                tuple(graph.sequence(earlier)),
                graph.marking(later),
                tuple(graph.sequence(later, earlier)),
            )
        )
        for answer in ("max_token_in_place", "max_token_per_marking", "place_bounds"):
            report.unknown[answer] = "the net is unbounded"
    elif graph.stopped:
        report.bounded = True if covered else None
        for answer in ("safe", "max_token_in_place", "max_token_per_marking", "place_bounds"):
            report.unknown[answer] = graph.stopped
        if not covered:
            report.unknown["bounded"] = graph.stopped
    else:
        bounds = [max(column) for column in zip(*graph.states, strict=True)]
        report.bounded = True
        report.max_token_in_place = max(bounds, default=0)
        report.safe = report.max_token_in_place <= 1
        report.max_token_per_marking = max(sum(vector) for vector in graph.states)
        report.place_bounds = dict(zip(compiled.places, bounds, strict=True))
    _overflow(report, graph)


def _overflow(report: Report, graph: Graph) -> None:
    places = graph.compiled.net.places.values()
    limited = [(i, p.name, p.capacity) for i, p in enumerate(places) if p.capacity is not None]
    for state, vector in enumerate(graph.states):
        for place, name, capacity in limited:
            if vector[place] > capacity:
                report.refusals.append(
                    Counterexample(
                        f"place {name} gets {vector[place]} tokens, more than its capacity of {capacity}",
                        tuple(graph.sequence(state)),
                        graph.marking(state),
                    )
                )
                return


def _deadlock(report: Report, graph: Graph, composition: Composition) -> None:
    transitions = graph.compiled.transitions
    external = {transitions.index(name) for name in composition.external}
    withdrawn = {i for i, t in enumerate(graph.compiled.net.transitions.values()) if t.role is Role.WITHDRAWN}
    at_rest = at_rest_test(composition, graph.compiled)
    for state, arcs in enumerate(graph.arcs):
        if any(transition not in external for transition, _ in arcs):
            continue
        waits = any(transition not in withdrawn for transition, _ in arcs)
        if at_rest(graph.states[state]) and (waits or (composition.may_end and external <= withdrawn)):
            continue
        marking = graph.marking(state)
        held = ", ".join(f"{place}={count}" for place, count in marking.items()) or "no token at all"
        kind = "it waits for its tape or a caller away from rest" if waits else "it is stuck"
        report.has_deadlock = True
        report.refusals.append(
            Counterexample(f"{kind} with {held}", tuple(graph.sequence(state)), marking),
        )
        return
    if graph.complete:
        report.has_deadlock = False
    else:
        report.unknown["has_deadlock"] = graph.stopped or "the net is unbounded"


def _dead_transitions(report: Report, graph: Graph) -> None:
    if not graph.complete:
        report.unknown["never_enabled_transitions"] = graph.stopped or "the net is unbounded"
        return
    fired = {transition for arcs in graph.arcs for transition, _ in arcs}
    report.never_enabled_transitions = [
        name for index, name in enumerate(graph.compiled.transitions) if index not in fired
    ]


def _lost_entries(report: Report, graph: Graph, composition: Composition) -> None:
    """Refuses a net in which a command or service that was possible can become impossible for ever."""
    before: list[list[int]] = [[] for _ in graph.states]
    offering: dict[int, list[int]] = {}
    entries = {graph.compiled.transitions.index(name) for name in composition.entries}
    for state, arcs in enumerate(graph.arcs):
        for transition, after in arcs:
            before[after].append(state)
            if transition in entries:
                offering.setdefault(transition, []).append(state)
    for transition, states in sorted(offering.items()):
        hopeful = set(states)
        stack = list(states)
        while stack:
            for earlier in before[stack.pop()]:
                if earlier not in hopeful:
                    hopeful.add(earlier)
                    stack.append(earlier)
        if len(hopeful) < len(graph.states):
            lost = next(state for state in range(len(graph.states)) if state not in hopeful)
            report.refusals.append(
                Counterexample(
                    f"after this {graph.compiled.transitions[transition]} can never fire again",
                    tuple(graph.sequence(lost)),
                    graph.marking(lost),
                )
            )
            return
