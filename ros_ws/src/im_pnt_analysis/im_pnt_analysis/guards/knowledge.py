"""Knowledge of values at the places of a net: guards passed on the way, and transitions answered."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, product

from im_pnt.expression.scope import NetScope
from im_pnt.expression.template import OPENS, Way
from im_pnt.model.action import AwaitAction
from im_pnt.model.net import Arcs, Guard, Net, Transition
from im_pnt.model.resources import resource_places
from im_pnt_analysis.guards.stored_values import facts_when_stored, named

NO_FAILURE = Guard("${failure.code == '' and failure.message == ''}")
"""Knowledge of a token without a failure behind it."""

MOST_WAYS = 16
"""Ways to a place that are told apart; of more, only what is common to all counts."""


@dataclass(frozen=True, slots=True)
class TokenKnowledge:
    """Knowledge of the command whose token lies in a place.

    Attributes:
        facts: Passed guards over values that stay the same.
        answered: Transitions whose answers are there.
        stored: Facts about the data objects that the net stores itself, as of the last stored values.
    """

    facts: frozenset[Guard] = frozenset()
    answered: frozenset[str] = frozenset()
    stored: frozenset[Guard] = frozenset()

    def joined(self, other: "TokenKnowledge") -> "TokenKnowledge":
        """Return the knowledge from two tokens of one command."""
        return TokenKnowledge(self.facts | other.facts, self.answered | other.answered, self.stored | other.stored)

    def covers(self, other: "TokenKnowledge") -> bool:
        """Return whether the knowledge fits each command that the other fits."""
        return self.facts <= other.facts and self.answered <= other.answered and self.stored <= other.stored

    def without(self, *names: Way) -> "TokenKnowledge":
        """Return the knowledge without the facts about names."""

        def keep(facts: frozenset[Guard]) -> frozenset[Guard]:
            return frozenset(fact for fact in facts if not any(p[: len(n)] == n for p in named(fact) for n in names))

        return TokenKnowledge(keep(self.facts), self.answered, keep(self.stored))

    def about(self, guards: Iterable[Guard]) -> "TokenKnowledge":
        """Return the knowledge without stored values foreign to guards and to the facts beside these values."""
        asked = {path for guard in (*guards, *self.facts) for path in named(guard)}
        kept = frozenset[Guard]()
        while more := frozenset(fact for fact in self.stored - kept if not asked.isdisjoint(named(fact))):
            kept |= more
            asked.update(path for fact in more for path in named(fact))
        return TokenKnowledge(self.facts, self.answered, kept)


Ways = Mapping[str, frozenset[TokenKnowledge]]
"""Knowledge at each place that is reached, one for each way there."""

_FAILURE = ("failure",)


class Knowledge:
    """Ways to the places of a net, by command or service.

    Args:
        net: The net as written.
        scope: Commands and services of its transitions.
        stored: Data objects that the net alone stores.

    Attributes:
        resources: Places whose tokens belong to nobody.
    """

    def __init__(self, net: Net, scope: NetScope, stored: frozenset[str]) -> None:
        self._net, self._scope, self._stored = net, scope, stored
        self.resources = resource_places(net)

    def work_inputs(self, transition: Transition) -> frozenset[str]:
        """Return the input places of a transition that are no resources."""
        return frozenset(transition.inputs) - self.resources

    def serves(self, transition: Transition, kind: str) -> bool:
        """Return whether tokens of a command or service may come to a transition."""
        return kind in self._scope.works_for(transition)

    def ways(self, kind: str) -> Ways:
        """Return the knowledge of a command or service at each reached place, way by way."""
        net, found = self._net, dict[str, frozenset[TokenKnowledge]]()
        if kind in net.services:
            found[net.services[kind].entry] = frozenset({TokenKnowledge(frozenset({NO_FAILURE}))})
        serving = [t for t in net.transitions.values() if self.serves(t, kind)]
        beside = self._beside(serving, kind)
        changed = True
        while changed:
            changed = False
            for transition in serving:
                for place, arriving in self._outcomes(transition, kind, found):
                    if place in self.resources:
                        continue  # the token is nobody's there
                    lasting = _without(arriving, *beside.get(place, ()))
                    before = found.get(place, frozenset())
                    after = _reduced(before | lasting)
                    if after != before:
                        found[place] = after
                        changed = True
        return found

    def together(self, places: frozenset[str], found: Ways) -> frozenset[TokenKnowledge]:
        """Return the knowledge of a command with tokens in several places; places never reached say nothing."""
        ways = [found[place] for place in sorted(places) if place in found]
        joined = {TokenKnowledge()} if ways else set[TokenKnowledge]()
        for several in ways:
            joined = set(_reduced(frozenset(one.joined(other) for one, other in product(joined, several))))
        if len(ways) > 1:  # the failure may be that of any of the tokens
            return _without(joined, _FAILURE)
        return frozenset(joined)

    def _outcomes(
        self, transition: Transition, kind: str, found: Ways
    ) -> Iterator[tuple[str, frozenset[TokenKnowledge]]]:
        begins = self.begins(transition, kind)
        before = frozenset({TokenKnowledge()}) if begins else self.together(self.work_inputs(transition), found)
        if transition.guard is not None:
            before = _learned(before, self._facts(transition.guard))
        if not before:
            return
        given = list(self._given(transition))
        unchanged = _without(before, *given, _FAILURE)
        after = self._stored_by(transition, before, given)
        if transition.action is not None:
            name = transition.retry_of or transition.name
            after = frozenset(replace(each, answered=each.answered | {name}) for each in after)
        if not transition.keeps_failure:
            after = _learned(_without(after, _FAILURE), [NO_FAILURE])
        if isinstance(transition.action, AwaitAction) and transition.action.until is not None:
            after = _learned(after, self._facts(Guard(transition.action.until)))
        for place in transition.outputs:
            yield place, after
        for place in chain(*self._failing(transition)):
            yield place, unchanged
        for place in transition.outputs:
            for other in self._net.places[place].on_invalid if place in self._net.places else ():
                yield other, _without(after, _FAILURE)

    def _stored_by(
        self, transition: Transition, before: frozenset[TokenKnowledge], given: list[Way]
    ) -> frozenset[TokenKnowledge]:
        """Return the knowledge when a transition has given its values."""
        if self._stored.isdisjoint(transition.store):
            return _without(before, *given)
        answers = [name for name in given if name[0] == "answers"]
        meanings, found = self._scope.meanings(transition), set[TokenKnowledge]()
        for each in _without(before, *answers):
            new = facts_when_stored(each.facts | each.stored, transition, self._stored, meanings)
            lasting = each.without(*given)
            found.add(replace(lasting, stored=lasting.stored | new))
        return frozenset(found)

    def begins(self, transition: Transition, kind: str) -> bool:
        """Return whether a transition begins a command with its symbol."""
        return transition.symbol == kind and transition.symbol_of is None

    def ends(self, transition: Transition) -> list[Arcs]:
        """Return the arcs of each end of a transition: its outputs, and those of a failure and of a doubt."""
        return [transition.outputs, *self._failing(transition)]

    def _failing(self, transition: Transition) -> list[Arcs]:
        """Return the arcs of a failure, and of a doubt."""
        failing = transition.on_failure or ({} if self._net.escalate is None else {self._net.escalate: 1})
        return [arcs for arcs in (failing if transition.action is not None else {}, transition.on_doubt) if arcs]

    def _given(self, transition: Transition) -> Iterator[Way]:
        """Yield the values that a transition gives anew."""
        if transition.action is not None:
            yield "answers", transition.retry_of or transition.name
        for name in transition.store:
            yield "data", name

    def _facts(self, guard: Guard) -> list[Guard]:
        """Return a passed guard if it is over values that stay the same until a transition gives them anew."""
        if guard.unless:
            return [guard] if all(map(self._facts, guard.unless)) else []
        stays = all(path[0] != "data" or path[1] in self._stored for path in named(guard))
        return [guard] if OPENS in guard.name and stays else []

    def _beside(self, serving: Iterable[Transition], kind: str) -> Mapping[str, frozenset[Way]]:
        """Return for each place the values that other tokens of the command may give anew while one lies there.

        Places are found that may be marked together, as far as pairs tell (A. Kovalyov, "Concurrency relations and the
        safety problem for Petri nets", 1992); an action is a place between its two phases.
        """
        steps: list[tuple[Arcs, Arcs]] = []
        for transition in serving:
            needed = {} if self.begins(transition, kind) else self.work(transition.inputs)
            if any(self._given(transition)):
                steps.append((needed, {_active(transition): 1}))
                needed = {_active(transition): 1}
            steps.append((needed, self.work(transition.outputs)))
            steps += [(needed, self.work(arcs)) for arcs in self._failing(transition)]
        for place in self._net.places.values():
            steps += [({place.name: 1}, self.work(dict.fromkeys(place.on_invalid, 1)))] if place.on_invalid else []
        entry = {self._net.services[kind].entry} if kind in self._net.services else set[str]()
        pairs = _marked_together(steps, entry)
        found: dict[str, frozenset[Way]] = {}
        for transition in serving:
            for name in self._given(transition):
                for one, other in pairs:
                    if one == _active(transition):
                        found[other] = found.get(other, frozenset()) | {name}
        return found

    def work(self, arcs: Arcs) -> dict[str, int]:
        """Return the arcs of places that are no resources."""
        return {place: weight for place, weight in arcs.items() if place not in self.resources}


def _active(transition: Transition) -> str:
    return f"{transition.name}.active"


def _marked_together(steps: list[tuple[Arcs, Arcs]], entry: set[str]) -> set[tuple[str, str]]:
    """Return the pairs of places, in both orders, that may hold a token each; of a place with itself: two."""
    reached, pairs = set(entry), set[tuple[str, str]]()
    while True:
        before = len(reached) + len(pairs)
        for needed, given in steps:
            apart = all((one, other) in pairs for one in needed for other in needed if one < other)
            if not needed.keys() <= reached or not apart:
                continue
            reached |= given.keys()
            beside = {place for place in reached if all((place, each) in pairs for each in needed)} if needed else set()
            new = {(one, other) for one in given for other in given if one != other or given[one] > 1}
            new |= {(one, other) for one in given for other in beside}
            pairs |= new | {(other, one) for one, other in new}
        if before == len(reached) + len(pairs):
            return pairs


def _learned(ways: Iterable[TokenKnowledge], facts: Iterable[Guard]) -> frozenset[TokenKnowledge]:
    return frozenset(replace(way, facts=way.facts.union(facts)) for way in ways)


def _without(ways: Iterable[TokenKnowledge], *names: Way) -> frozenset[TokenKnowledge]:
    return frozenset(way.without(*names) for way in ways)


def _reduced(ways: frozenset[TokenKnowledge]) -> frozenset[TokenKnowledge]:
    """Leave out covered ways; of too many, join those with different stored values alone."""
    least = frozenset(way for way in ways if not any(other != way and other.covers(way) for other in ways))
    if len(least) > MOST_WAYS:
        alike: dict[TokenKnowledge, list[TokenKnowledge]] = {}
        for way in least:
            alike.setdefault(replace(way, stored=frozenset()), []).append(way)
        least = frozenset(_common(several) for several in alike.values())
    return least if len(least) <= MOST_WAYS else frozenset({_common(least)})


def _common(ways: Iterable[TokenKnowledge]) -> TokenKnowledge:
    return TokenKnowledge(
        frozenset.intersection(*(way.facts for way in ways)),
        frozenset.intersection(*(way.answered for way in ways)),
        frozenset.intersection(*(way.stored for way in ways)),
    )
