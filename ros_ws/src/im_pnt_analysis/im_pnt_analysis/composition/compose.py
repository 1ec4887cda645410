"""Several nets as one, with the environment.

Nets are joined over remote places (paper, Figure 9) and coordination structures (Figure 11). What lies outside the
given nets is modelled, each by its most general behaviour:

* the input tape is free: any symbol may be there at any time;
* a service that none of the given nets asks for has one generic caller, who asks again after each reply;
* a request to a net that is not given is answered either way;
* a remote place that none of the given nets marks gets a token whenever everything is at rest: inhibitor arcs from all
  places that are busy then say so; unless its net assumes something else (:mod:`.assumptions`);
* an object of a place with ``on_invalid`` may lose its validity, an action may be cancelled or come in doubt, at any
  time.

Tokens and requests for a given net are on their way for a while: they are on ``p.underway`` before they are on ``p``.

A transition that empties places is there once for each number of tokens that it may find (:mod:`.resets`).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from im_core.errors import nearest
from im_pnt.errors import NetError
from im_pnt.model.action import AwaitAction
from im_pnt.model.expand import INPUT_SEMAPHORE, expand, input_place
from im_pnt.model.groups import nets_by_name
from im_pnt.model.net import Net, Role, Transition
from im_pnt.model.resources import resource_places
from im_pnt_analysis.composition.arguments import check_arguments
from im_pnt_analysis.composition.assumptions import Assumptions
from im_pnt_analysis.composition.flat_net import NOT_LOOKED_AT, FlatNet
from im_pnt_analysis.composition.requests import ServiceCalls
from im_pnt_analysis.composition.resets import stop_above_capacity, ways_to_empty
from im_pnt_analysis.guards.coverage import GuardDecisions, decide_guards

_BOUNDED = ("constant", "uniform", "triangular")
"""Delays of which not every one may be over before every other one."""
_DISTURBANCES = (Role.WITHDRAWN, Role.CANCEL, Role.LOST)


@dataclass(frozen=True, slots=True)
class Composition:
    """Expanded nets flattened into one, closed by an environment.

    Attributes:
        net: The flat net; names are ``net.place`` where there are several nets.
        external: Transitions that wait for something from outside: symbols, callers, remote tokens, disturbances.
        disturbances: Those that may happen and that nobody can count on: lost validity, cancelling, doubt.
        entries: Transitions that begin something for a client, and must not become impossible for ever.
        rest: Places that may hold tokens at rest.
        net_of: For each place the net it belongs to, or that it surrounds.
        may_end: Whether a net declares where it rests, and may therefore come to an end there.
        assumptions: What the verdicts take for granted.
        promises: For places whose capacity is what a net assumes of others, what is said when it is exceeded, with
            ``{tokens}`` in it.
        debts: For places that must be able to become empty again, for a net assumes it, what is said when they cannot.
        watching: Transitions that fire only where such a promise is broken, and are none of the nets'.
        ways: Transitions that are one way to fire another, which is none of the composition, with the name of that.
        emptied: Places that transitions empty; above their capacities nothing fires.
    """

    net: Net
    external: frozenset[str]
    disturbances: frozenset[str]
    entries: frozenset[str]
    rest: frozenset[str]
    net_of: Mapping[str, str]
    may_end: bool
    assumptions: tuple[str, ...]
    promises: Mapping[str, str]
    debts: Mapping[str, str]
    watching: frozenset[str]
    ways: Mapping[str, str]
    emptied: frozenset[str]


def compose(nets: Sequence[Net]) -> Composition:
    """Join nets and close the result with an environment.

    Args:
        nets: Nets as written or expanded, with different names.

    Raises:
        NetError: Two nets of one name, a service or remote place that its net does not have, no net at all, or guards
            that leave out a value.

    >>> composition = compose([oven])
    >>> list(composition.net.transitions), composition.external, composition.rest
    (['load', 'bake', 'empty'], frozenset({'load'}), frozenset({'cold'}))
    """
    if not nets:
        raise NetError("there is no net to analyse")
    by_name = {name: expand(net) for name, net in nets_by_name(nets).items()}
    check_arguments(nets)
    flat = FlatNet(by_name)
    composer = _Composer(flat, {net.name: decide_guards(net) for net in nets})
    for net in by_name.values():
        composer.add(net)
    composer.close()
    emptied = {flat.qualified(net.name, p) for net in nets for t in net.transitions.values() for p in t.resets}
    stop_above_capacity(flat, emptied)
    name = "+".join(by_name)
    return Composition(
        Net(name, flat.places, flat.transitions, rest=tuple(sorted(flat.rest)), source=name),
        frozenset(flat.external),
        frozenset(composer.disturbances),
        frozenset(composer.entries),
        frozenset(flat.rest),
        flat.net_of,
        any(net.rest is not None for net in nets),
        tuple(flat.assumptions),
        composer.assumed.promises,
        composer.assumed.debts,
        frozenset(composer.assumed.watching),
        composer.ways,
        frozenset(emptied),
    )


class _Composer:
    def __init__(self, flat: FlatNet, decisions: Mapping[str, GuardDecisions]) -> None:
        self.flat, self.decisions = flat, decisions
        self.assumed = Assumptions(flat)
        self.calls = ServiceCalls(flat, self.assumed.promises)
        self.disturbances: set[str] = set()
        self.entries: set[str] = set()
        self.fed: set[str] = set()
        self.ways: dict[str, str] = {}

    def add(self, net: Net) -> None:
        """Add the places and transitions of a net."""
        flat = self.flat
        certain = self.calls.certain_places(net)
        for place in net.places.values():
            if place.name not in certain:
                flat.add_place(net.name, replace(place, name=flat.qualified(net.name, place.name)))
        flat.rest.update(flat.qualified(net.name, place) for place in net.rest_places())
        for transition in net.transitions.values():
            for connected in self.calls.connected(net, self._qualified(net, transition)):
                for part in self.assumed.kept(net, transition, connected):
                    for way in ways_to_empty(part, flat.places):
                        if way is not part:
                            self.ways[way.name] = part.name
                        self._add_part(way)

    def _add_part(self, part: Transition) -> None:
        flat = self.flat
        flat.add_transition(part)
        if part.role in _DISTURBANCES:
            self.disturbances.add(part.name)
        if part.symbol or part.role in _DISTURBANCES:
            flat.external.add(part.name)
        if part.symbol or part.role is Role.ACCEPT:
            self.entries.add(part.name)

    def _qualified(self, net: Net, transition: Transition) -> Transition:
        flat = self.flat
        outputs = flat.arcs(net.name, transition.outputs)
        for remote, weight in transition.remote_outputs.items():
            target = self._remote_target(net, transition, remote.net, remote.place)
            if target is not None:
                outputs[target] = outputs.get(target, 0) + weight
        return replace(
            transition,
            name=flat.qualified(net.name, transition.name),
            inputs=flat.arcs(net.name, transition.inputs),
            outputs=outputs,
            remote_outputs={},
            inhibitors=flat.arcs(net.name, transition.inhibitors),
            resets=tuple(flat.qualified(net.name, place) for place in transition.resets),
        )

    def _remote_target(self, net: Net, transition: Transition, other: str, place: str) -> str | None:
        target = self.flat.nets.get(other)
        if target is None:
            self.flat.assume(f"net {other}, to whose place {place} net {net.name} sends tokens, is left out")
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
        self.fed.add(self.flat.qualified(other, place))
        return self.flat.underway(other, place)

    def close(self) -> None:
        """Add sources for remote places without a given net, and the assumptions behind the sources."""
        flat = self.flat
        arrivals = []
        for net in flat.nets.values():
            inputs_of_services = {input_place(service) for service in net.services}
            for place in net.places.values():
                name = flat.qualified(net.name, place.name)
                if (net.name, place.name) in self.assumed.settled:
                    continue
                if place.remote and place.name not in inputs_of_services and name not in self.fed:
                    arrival = flat.qualified(net.name, f"arrive.{place.name}")
                    arrivals.append(Transition(arrival, outputs={name: 1}, origin=place.name))
                    flat.assume(f"other nets mark {name} only while everything is at rest")
        busy = {place: 1 for place in flat.places if place not in flat.rest}
        for transition in arrivals:
            flat.add_environment(replace(transition, inhibitors=busy))
        for text in assumptions(list(flat.nets.values()), self.decisions):
            flat.assume(text)
        for name, decisions in self.decisions.items():
            if values := decisions.granted:
                told = "without one a guard counts as false"
                flat.assume(f"{NOT_LOOKED_AT}whether each command brings {', '.join(sorted(values))} ({name}): {told}")
        if any(INPUT_SEMAPHORE in net.places for net in flat.nets.values()):
            flat.assume("requests of different callers are served in any order")


def assumptions(nets: Sequence[Net], decisions: Mapping[str, GuardDecisions]) -> Iterator[str]:
    """Return the assumptions.

    Args:
        nets: The nets, expanded.
        decisions: By net those about its guards.
    """
    if guarded := _names(net for net in nets if net.guards()):
        yield (
            f"guards ({guarded}) may be true or false at any time: bounds and safety hold whatever they say; liveness "
            "and the return of resources hold unless a guard stays as it is for ever"
        )
    for net in nets:
        yield from open_guards(net, decisions[net.name].decided)
    if reading := _names(net for net in nets if net.symbols()):
        yield (
            f"tapes ({reading}) are free, any symbol may come at any time: bounds and safety hold for every tape; "
            "liveness holds where each symbol comes again and again"
        )
    if acting := _names(net for net in nets if any(t.role is Role.START for t in net.transitions.values())):
        yield f"actions ({acting}) end, fail, or come in doubt, which is then decided either way"
    for net in nets:
        transitions = net.transitions.values()
        clocks = [t for t in transitions if t.action is None and t.delay is not None and t.delay.kind in _BOUNDED]
        if len(clocks) > 1 or (clocks and any(t.role is Role.START or t.symbol for t in transitions)):
            yield f"{NOT_LOOKED_AT}how long the delays of {_names(clocks)} are ({net.name}): any may be over first"
        ended = {t.cancels for t in transitions}  # such as the watch of an interrupt: nothing waits for its message
        awaits = (t for t in transitions if isinstance(t.action, AwaitAction) and t.origin not in ended)
        endless = [t.origin for t in awaits if t.timeout is None]
        if endless:
            told = "without a timeout they wait for ever"
            yield f"{NOT_LOOKED_AT}whether the messages of {', '.join(endless)} ({net.name}) come: {told}"


def _names(named: Iterable[Net | Transition]) -> str:
    return ", ".join(each.name for each in named)


def _beside_work(transition: Transition, resources: frozenset[str]) -> tuple[Mapping[str, int], Mapping[str, int]]:
    """Return what a transition needs beside the tokens of the command: resources, and places without tokens."""
    return {place: transition.inputs[place] for place in transition.inputs if place in resources}, transition.inhibitors


def open_guards(net: Net, decided: frozenset[str]) -> Iterator[str]:
    """Return the guards without a counterpart: such a guard might keep a net waiting for ever."""
    waits, resources = [], resource_places(net)
    for transition in net.transitions.values():
        if transition.guard is None or transition.origin in decided or transition.guard.name == "cancelled":
            continue  # a cancelled command has this way out beside those of others
        opposite = replace(transition.guard, negated=not transition.guard.negated)
        needs = _beside_work(transition, resources)
        rivals = (
            t
            for t in net.transitions.values()
            if t.inputs
            and t.inputs.keys() <= transition.inputs.keys()  # of more tokens one may be missing
            and t != transition
            and _beside_work(t, resources) == needs
        )
        if not any(t.guard == opposite or (t.guard is None and t.symbol is None) for t in rivals):
            waits.append(f"'{transition.guard}' ({transition.origin})")
    if waits:
        told = "nothing else takes the tokens meanwhile"
        yield f"{NOT_LOOKED_AT}whether each of the guards {', '.join(waits)} becomes true ({net.name}): {told}"
