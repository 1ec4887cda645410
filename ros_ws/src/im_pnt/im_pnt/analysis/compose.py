"""Several nets as one, with what surrounds them.

Nets are joined over remote places (paper, Figure 9) and coordination structures (Figure 11). What lies outside the
given nets is modelled, each by its most general behaviour:

* the input tape is free: any symbol may be there at any time;
* a service that none of the given nets asks for has one generic caller, who asks again after each reply;
* a request to a net that is not given is answered either way;
* a remote place that none of the given nets marks gets a token whenever everything is at rest;
* an object of a place with ``on_invalid`` may lose its validity at any time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from im_pnt.errors import NetError, nearest
from im_pnt.expand import INPUT_SEMAPHORE, expand, input_place
from im_pnt.net import Arcs, Net, Place, RequestAction, Role, Transition


@dataclass(frozen=True, slots=True)
class Composition:
    """Expanded nets flattened into one, closed by an environment.

    Attributes:
        net: The flat net; names are ``net.place`` where there are several nets.
        external: Transitions that wait for something from outside: symbols, callers, remote tokens, lost validity.
        at_rest_only: Those of the environment that fire only while everything is at rest.
        entries: Transitions that begin something for a client, and must not become impossible for ever.
        rest: Places that may hold tokens at rest.
        may_end: Whether a net declares where it rests, and may therefore come to an end there.
        assumptions: What the verdicts take for granted.
    """

    net: Net
    external: frozenset[str]
    at_rest_only: frozenset[str]
    entries: frozenset[str]
    rest: frozenset[str]
    may_end: bool
    assumptions: tuple[str, ...]


@dataclass(slots=True)
class _Parts:
    places: dict[str, Place] = field(default_factory=dict)
    transitions: dict[str, Transition] = field(default_factory=dict)
    external: set[str] = field(default_factory=set)
    at_rest_only: set[str] = field(default_factory=set)
    entries: set[str] = field(default_factory=set)
    rest: set[str] = field(default_factory=set)
    assumptions: dict[str, None] = field(default_factory=dict)


def compose(nets: Sequence[Net]) -> Composition:
    """Joins nets and closes them with an environment.

    Args:
        nets: Nets as written or expanded, with different names.

    Raises:
        NetError: Two nets of one name, a service or remote place that its net does not have, or no net at all.
    """
    if not nets:
        raise NetError("there is no net to analyse")
    by_name: dict[str, Net] = {}
    for net in nets:
        if net.name in by_name:
            raise NetError(f"there are two nets named {net.name} ({by_name[net.name].source}, {net.source})")
        by_name[net.name] = expand(net)
    composer = _Composer(by_name)
    for net in by_name.values():
        composer.add(net)
    composer.close()
    parts = composer.parts
    name = "+".join(by_name)
    flat = Net(name, parts.places, parts.transitions, rest=tuple(sorted(parts.rest)), source=name)
    return Composition(
        flat,
        frozenset(parts.external),
        frozenset(parts.at_rest_only),
        frozenset(parts.entries),
        frozenset(parts.rest),
        any(net.rest is not None for net in nets),
        tuple(parts.assumptions),
    )


class _Composer:
    def __init__(self, nets: dict[str, Net]) -> None:
        self.nets = nets
        self.parts = _Parts()
        self._callers: dict[tuple[str, str], list[str]] = {}
        self._fed: set[str] = set()
        for net in nets.values():
            for transition in net.transitions.values():
                if transition.role is Role.START and isinstance(transition.action, RequestAction):
                    key = (transition.action.net, transition.action.service)
                    self._callers.setdefault(key, []).append(self.q(net.name, transition.origin))

    def q(self, net: str, name: str) -> str:
        """Qualifies a name where there are several nets."""
        return f"{net}.{name}" if len(self.nets) > 1 else name

    def arcs(self, net: str, arcs: Arcs) -> dict[str, int]:
        return {self.q(net, place): weight for place, weight in arcs.items()}

    def add(self, net: Net) -> None:
        parts = self.parts
        for place in net.places.values():
            parts.places[self.q(net.name, place.name)] = replace(place, name=self.q(net.name, place.name))
        parts.rest.update(self.q(net.name, place) for place in net.rest_places())
        for transition in net.transitions.values():
            for flat in self._flat(net, transition):
                parts.transitions[flat.name] = flat
                if flat.symbol or flat.role is Role.WITHDRAWN:
                    parts.external.add(flat.name)
                if flat.symbol or flat.role is Role.ACCEPT:
                    parts.entries.add(flat.name)

    def _flat(self, net: Net, transition: Transition) -> Iterator[Transition]:
        inputs = self.arcs(net.name, transition.inputs)
        outputs = self.arcs(net.name, transition.outputs)
        for remote, weight in transition.remote_outputs.items():
            target = self._remote_target(net, transition, remote.net, remote.place)
            if target is not None:
                outputs[target] = outputs.get(target, 0) + weight
        flat = replace(
            transition,
            name=self.q(net.name, transition.name),
            inputs=inputs,
            outputs=outputs,
            remote_outputs={},
            inhibitors=self.arcs(net.name, transition.inhibitors),
        )
        if transition.role in (Role.START, Role.END, Role.FAILED):
            action = net.transitions[f"{transition.origin}.start"].action
            if isinstance(action, RequestAction):
                flat = self._request_phase(net, flat, action)
        if transition.role is not Role.RETURN:
            yield flat
            return
        callers = self._callers.get((net.name, transition.origin), [])
        for caller in callers:
            yield replace(
                flat,
                name=f"{flat.name}({caller})",
                inputs={**inputs, f"{caller}.pending": 1},
                outputs={**outputs, f"{caller}.reply": 1},
            )
        if not callers:
            yield replace(flat, outputs={**outputs, self._generic_caller(net.name, transition.origin): 1})

    def _request_phase(self, net: Net, flat: Transition, action: RequestAction) -> Transition:
        server = self.nets.get(action.net)
        if server is None:
            self._assume(f"{action} of net {net.name} is answered, either way")
            return flat
        if action.service not in server.services:
            raise NetError(
                f"transition {flat.origin} of net {net.name} asks for {action.net}.{action.service}, "
                f"which net {action.net} does not offer{nearest(action.service, server.services)}"
            )
        caller = self.q(net.name, flat.origin)
        for place in (f"{caller}.pending", f"{caller}.reply"):
            self.parts.places[place] = Place(place)
        if flat.role is Role.START:
            request = self.q(action.net, input_place(action.service))
            self._assume(f"{action} of net {net.name} gets its reply: no time-out, no dead coordinator")
            return replace(flat, outputs={**flat.outputs, f"{caller}.pending": 1, request: 1})
        return replace(flat, inputs={**flat.inputs, f"{caller}.reply": 1})

    def _remote_target(self, net: Net, transition: Transition, other: str, place: str) -> str | None:
        target = self.nets.get(other)
        if target is None:
            self._assume(f"net {other}, to whose place {place} net {net.name} sends tokens, is left out")
            return None
        if place not in target.places:
            raise NetError(
                f"transition {transition.origin} of net {net.name} sends a token to {other}.{place}, "
                f"a place that net {other} does not have{nearest(place, target.places)}"
            )
        if not target.places[place].remote:
            raise NetError(
                f"transition {transition.origin} of net {net.name} sends a token to {other}.{place}, "
                f"which is not open to other nets; give it 'remote: true' in net {other}"
            )
        self._fed.add(self.q(other, place))
        return self.q(other, place)

    def _generic_caller(self, net: str, service: str) -> str:
        idle = self.q(net, f"caller.{service}")
        self.parts.places[idle] = Place(idle, tokens=1)
        self.parts.rest.add(idle)
        self._environment(
            Transition(
                self.q(net, f"call.{service}"),
                inputs={idle: 1},
                outputs={self.q(net, input_place(service)): 1},
                role=Role.ENVIRONMENT,
                origin=service,
            )
        )
        return idle

    def _environment(self, transition: Transition) -> None:
        self.parts.transitions[transition.name] = transition
        self.parts.external.add(transition.name)

    def _assume(self, text: str) -> None:
        self.parts.assumptions[text] = None

    def close(self) -> None:
        """Adds what marks the remote places that no given net marks, and says what guards leave open."""
        for net in self.nets.values():
            inputs_of_services = {input_place(service) for service in net.services}
            for place in net.places.values():
                name = self.q(net.name, place.name)
                if place.remote and place.name not in inputs_of_services and name not in self._fed:
                    arrival = self.q(net.name, f"arrive.{place.name}")
                    self._environment(Transition(arrival, outputs={name: 1}, role=Role.ENVIRONMENT, origin=place.name))
                    self.parts.at_rest_only.add(arrival)
                    self._assume(f"other nets mark {name} only while everything is at rest")
            for text in open_guards(net):
                self._assume(text)
        if any(INPUT_SEMAPHORE in net.places for net in self.nets.values()):
            self._assume("requests of different callers are served in any order")


def open_guards(net: Net) -> Iterator[str]:
    """Names the guards that have no counterpart, and might keep a net waiting for ever."""
    guarded = [t for t in net.transitions.values() if t.guard]
    for transition in guarded:
        assert transition.guard is not None
        opposite = replace(transition.guard, negated=not transition.guard.negated)
        rivals = (t for t in net.transitions.values() if t.inputs.keys() & transition.inputs.keys() and t != transition)
        if not any(t.guard == opposite or (t.guard is None and t.symbol is None) for t in rivals):
            yield (
                f"guard '{transition.guard}' of transition {transition.origin} of net {net.name} becomes true: "
                "nothing else takes the tokens while it is false"
            )
