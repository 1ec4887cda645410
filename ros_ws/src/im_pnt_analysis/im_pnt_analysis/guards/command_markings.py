"""Markings of the tokens of one command: guards, resources and other commands count as giving way."""

from collections import deque
from collections.abc import Iterator

from im_pnt.model.action import AwaitAction
from im_pnt.model.net import Arcs, Net, Transition
from im_pnt_analysis.guards.knowledge import Knowledge

MOST_MARKINGS = 5_000
"""Markings of a command that are looked at; of a net with more, guards stay undecided."""

Marking = frozenset[tuple[str, int]]


class CommandMarkings:
    """Reachable markings of one command or service, an action being a step.

    Args:
        net: The net as written.
        knowledge: Tells the tokens of commands from resources.
        kind: Symbol of the command, or name of the service.

    Attributes:
        complete: Whether all markings were visited, once the iteration is over.
    """

    def __init__(self, net: Net, knowledge: Knowledge, kind: str) -> None:
        self._net, self._knowledge, self._kind = net, knowledge, kind
        serving = [each for each in net.transitions.values() if knowledge.serves(each, kind)]
        self._beginning = [each for each in serving if knowledge.begins(each, kind)]
        self._needs = {each.name: knowledge.work(each.inputs) for each in serving if not knowledge.begins(each, kind)}
        self._steps = [net.transitions[name] for name, needed in self._needs.items() if needed]
        self.complete = True

    def __iter__(self) -> Iterator[tuple[frozenset[str], list[Transition]]]:
        """Yield the marked places and the transitions that these tokens enable, for each marking."""
        found = dict.fromkeys(self._first())
        pending = deque(found)
        while pending:
            marking = pending.popleft()
            tokens = dict(marking)
            enabled = [each for each in self._steps if self._is_enabled(each, tokens)]
            yield frozenset(tokens), [each for each in enabled if each.cancels is None]
            for after in self._after(tokens, enabled):
                if after not in found:
                    if len(found) >= MOST_MARKINGS:
                        self.complete = False
                        return
                    found[after] = None
                    pending.append(after)

    def _first(self) -> Iterator[Marking]:
        service = self._net.services.get(self._kind)
        if service is not None:
            yield frozenset({(service.entry, 1)})
        for transition in self._beginning:
            for arcs in self._knowledge.ends(transition):
                yield _marking({}, self._knowledge.work(arcs))

    def _is_enabled(self, transition: Transition, tokens: Arcs) -> bool:
        """Return whether tokens enable a transition; one that cancels an action, while that action may run."""
        if any(tokens.get(place, 0) < weight for place, weight in self._needs[transition.name].items()):
            return False
        if transition.cancels is not None and transition.cancels in self._needs:
            running = self._needs[transition.cancels].items()
            return all(tokens.get(place, 0) >= weight for place, weight in running)
        own = self._knowledge.work(transition.inhibitors)
        return all(tokens.get(place, 0) < weight for place, weight in own.items())

    def _after(self, tokens: Arcs, enabled: list[Transition]) -> Iterator[Marking]:
        for transition in enabled:
            needed = self._needs[transition.name]
            left = {place: count - needed.get(place, 0) for place, count in tokens.items()}
            left = {place: count for place, count in left.items() if place not in transition.resets}
            for arcs in self._knowledge.ends(transition):
                yield _marking(left, self._knowledge.work(arcs))
        for place, count in tokens.items():
            lost = self._net.places[place].on_invalid if place in self._net.places else ()
            if lost:
                yield _marking({**tokens, place: count - 1}, self._knowledge.work(dict.fromkeys(lost, 1)))


def may_never_fire(transition: Transition) -> bool:
    """Return whether an enabled transition waits for a word, or for a message without a timeout and a guard."""
    endless = isinstance(transition.action, AwaitAction) and transition.timeout is None
    return transition.symbol is not None or (endless and transition.guard is None)


def _marking(left: Arcs, given: Arcs) -> Marking:
    counts = {place: left.get(place, 0) + given.get(place, 0) for place in (*left, *given)}
    return frozenset((place, count) for place, count in counts.items() if count > 0)
