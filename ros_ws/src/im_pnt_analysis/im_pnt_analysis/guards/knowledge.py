"""Knowledge of values at the places of a net: guards passed on the way, and transitions answered."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

from im_pnt.expression.scope import NetScope
from im_pnt.expression.template import OPENS, nodes, references
from im_pnt.expression.types import NoTypes
from im_pnt.model.net import Guard, Net, Transition
from im_pnt.model.resources import resource_places

MOST_WAYS = 16
"""Ways to a place that are told apart; of more, only what is common to all counts."""


@dataclass(frozen=True, slots=True)
class TokenKnowledge:
    """Knowledge of the command whose token lies in a place.

    Attributes:
        facts: Passed guards over values that stay the same.
        answered: Transitions whose answers are there.
    """

    facts: frozenset[Guard] = frozenset()
    answered: frozenset[str] = frozenset()

    def joined(self, other: "TokenKnowledge") -> "TokenKnowledge":
        """Return the knowledge from two tokens of one command."""
        return TokenKnowledge(self.facts | other.facts, self.answered | other.answered)

    def covers(self, other: "TokenKnowledge") -> bool:
        """Return whether the knowledge fits each command that the other fits."""
        return self.facts <= other.facts and self.answered <= other.answered


Ways = Mapping[str, frozenset[TokenKnowledge]]
"""Knowledge at each place that is reached, one for each way there."""


class Knowledge:
    """Ways to the places of a net, by command or service."""

    def __init__(self, net: Net) -> None:
        self._net = net
        self._scope = NetScope(net, NoTypes())
        self._resources = resource_places(net)

    def work_inputs(self, transition: Transition) -> frozenset[str]:
        """Return the input places of a transition that are no resources."""
        return frozenset(transition.inputs) - self._resources

    def serves(self, transition: Transition, kind: str) -> bool:
        """Return whether tokens of a command or service may come to a transition."""
        return kind in self._scope.works_for(transition)

    def ways(self, kind: str) -> Ways:
        """Return the knowledge of a command or service at each reached place, way by way."""
        net, found = self._net, dict[str, frozenset[TokenKnowledge]]()
        if kind in net.services:
            found[net.services[kind].entry] = frozenset({TokenKnowledge()})
        serving = [t for t in net.transitions.values() if self.serves(t, kind)]
        changed = True
        while changed:
            changed = False
            for transition in serving:
                for place, arriving in self._outcomes(transition, kind, found):
                    before = found.get(place, frozenset())
                    after = _reduced(before | arriving)
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
        return frozenset(joined)

    def _outcomes(
        self, transition: Transition, kind: str, found: Ways
    ) -> Iterator[tuple[str, frozenset[TokenKnowledge]]]:
        begins = transition.symbol == kind and transition.symbol_of is None
        before = frozenset({TokenKnowledge()}) if begins else self.together(self.work_inputs(transition), found)
        if transition.guard is not None and _is_fact(transition.guard):
            before = frozenset(TokenKnowledge(each.facts | {transition.guard}, each.answered) for each in before)
        if not before:
            return
        acts, name = transition.action is not None, transition.retry_of or transition.name
        if acts:
            before = frozenset(TokenKnowledge(_without(each.facts, "answers", name), each.answered) for each in before)
        after = frozenset(TokenKnowledge(each.facts, each.answered | {name}) for each in before) if acts else before
        for place in transition.outputs:
            yield place, after
        failing = transition.on_failure or ({} if self._net.escalate is None else {self._net.escalate: 1})
        failed = frozenset(TokenKnowledge(_without(each.facts, "failure"), each.answered) for each in before)
        for place in (*(failing if acts else ()), *transition.on_doubt):
            yield place, failed
        for place in transition.outputs:
            for other in self._net.places[place].on_invalid if place in self._net.places else ():
                yield other, after


def named(guard: Guard) -> frozenset[tuple[str, ...]]:
    """Return the names in the expressions of a guard: roots, and what follows."""
    return frozenset(path for each in (guard, *guard.unless) for node in nodes(each.name) for path in references(node))


def _is_fact(guard: Guard) -> bool:
    if guard.unless:
        return all(map(_is_fact, guard.unless))
    return OPENS in guard.name and all(path[0] != "data" for path in named(guard))


def _without(facts: frozenset[Guard], *path: str) -> frozenset[Guard]:
    """Return the facts that say nothing of a name."""
    return frozenset(fact for fact in facts if not any(name[: len(path)] == path for name in named(fact)))


def _reduced(ways: frozenset[TokenKnowledge]) -> frozenset[TokenKnowledge]:
    """Leave out each way that another covers; too many become one."""
    least = frozenset(way for way in ways if not any(other != way and other.covers(way) for other in ways))
    if len(least) <= MOST_WAYS:
        return least
    facts = frozenset.intersection(*(way.facts for way in least))
    return frozenset({TokenKnowledge(facts, frozenset.intersection(*(way.answered for way in least)))})
