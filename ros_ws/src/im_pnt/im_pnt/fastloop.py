"""Firing without ceremony: transitions that only move tokens, and plain functions, while nobody looks on.

It fires what :class:`im_pnt.choosing.Chooser` would choose, in the same order, and leaves the same marking. It may run
only while no firing is told or recorded and no token carries a lineage, for then nothing else could be noticed.
"""

import inspect
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from im_pnt.acting import Actions
from im_pnt.choosing import Chooser
from im_pnt.events import Event
from im_pnt.firing import FiringRule
from im_pnt.functions import ActionFunction
from im_pnt.net import Role, Transition

_MOST_RIVALS = 32

_Places = tuple[tuple[int, tuple[int, ...]], ...]
"""Places, each with the transitions that take from it."""


class _Quick(NamedTuple):
    """A transition that can be fired here.

    Attributes:
        inputs: Its input places.
        rivals: The other transitions that share one of them.
        outputs: Its output places; for a ``t.start`` those of ``t.end``.
        function: The function that it calls, None where it calls none.
    """

    inputs: _Places
    rivals: tuple[int, ...]
    outputs: _Places
    function: ActionFunction | None


class FastLoop:
    """Fires the transitions of a net that need no more than tokens and a call.

    Args:
        rule: The marking.
        chooser: Decides about contending transitions.
        inbox: Events that wait; they go first.
        actions: Has actions done that are more than a call.
        fire: Fires a transition that has won against one of this loop, and is none itself.

    Attributes:
        calling: The transition whose function is being called, -1 where none is.
    """

    def __init__(
        self,
        rule: FiringRule,
        chooser: Chooser,
        inbox: deque[Event],
        actions: Actions,
        fire: Callable[[int], None],
    ) -> None:
        self.calling = -1
        self._rule, self._chooser, self._inbox = rule, chooser, inbox
        self._actions, self._fire = actions, fire
        consumers = [tuple(t for t, _ in row) for row in rule.enabling.compiled.consumers]
        plain = [self._is_plain(place) for place in range(len(consumers))]
        self._rows = [self._row(index, consumers, plain) for index in range(len(rule.transitions))]
        self._contexts = [actions.fresh_context(index) for index in range(len(rule.transitions))]

    def run(self, limit: int) -> int:
        """Fires until an event waits, a transition is not for this loop, nothing is enabled, or the limit is reached.

        Args:
            limit: Most firings.

        Returns:
            The number of firings of transitions as written.
        """
        rows, contexts, inbox, actions = self._rows, self._contexts, self._inbox, self._actions
        enabling, teller = self._rule.enabling, self._rule.teller
        tokens, unmet, listed, agenda = enabling.tokens, enabling.unmet, enabling.listed, enabling.agenda
        pop, push = agenda.popleft, agenda.append
        fired = told = 0
        while agenda and fired < limit and not inbox:
            index = pop()
            listed[index] = False
            if unmet[index]:
                continue
            row = rows[index]
            if row is None:
                agenda.appendleft(index)
                listed[index] = True
                break
            inputs, rivals, outputs, function = row
            for rival in rivals:
                if not unmet[rival]:
                    winner = self._chooser.draw([index, *(rival for rival in rivals if not unmet[rival])])
                    if winner != index:
                        listed[index] = True
                        push(index)
                        index, row = winner, rows[winner]
                        if row is None:
                            teller.sequence += told
                            self._fire(index)
                            return fired + 1
                        inputs, _, outputs, function = row
                    break
            for place, consumers in inputs:
                left = tokens[place] - 1
                tokens[place] = left
                if not left:
                    for consumer in consumers:
                        unmet[consumer] += 1
            fired += 1
            told += 1
            if function is not None:
                self.calling = index
                context = contexts[index]
                error: BaseException | None = None
                try:
                    outcome = function(context)
                except BaseException as raised:  # an action is foreign code: whatever it raises is its failure
                    outcome, error = None, raised
                if outcome is not None or error is not None or context.used:
                    contexts[index] = actions.fresh_context(index)
                    if error is not None or inspect.isawaitable(outcome):
                        self.calling = -1
                        teller.sequence += told - 1
                        try:
                            actions.took(index, context, outcome, error)
                        finally:
                            if not unmet[index]:
                                enabling.consider(index)
                        return fired
                told += 1
            for place, consumers in outputs:
                before = tokens[place]
                tokens[place] = before + 1
                if not before:
                    for consumer in consumers:
                        left = unmet[consumer] - 1
                        unmet[consumer] = left
                        if not left and not listed[consumer]:
                            listed[consumer] = True
                            push(consumer)
            if not unmet[index] and not listed[index]:
                listed[index] = True
                push(index)
        self.calling = -1
        teller.sequence += told
        return fired

    def _is_plain(self, place: int) -> bool:
        """Whether tokens may come and go on a place without more than counting."""
        compiled = self._rule.enabling.compiled
        transitions = self._rule.transitions
        return not compiled.inhibited[place] and all(
            weight == 1 and transitions[t].guard is None and t not in self._chooser.delayed
            for t, weight in compiled.consumers[place]
        )

    def _row(self, index: int, consumers: list[tuple[int, ...]], plain: list[bool]) -> _Quick | None:
        rule = self._rule
        transition, compiled = rule.transitions[index], rule.enabling.compiled
        last = index
        function: ActionFunction | None = None
        if transition.role is Role.START:
            last = rule.number[f"{transition.origin}.end"]
            function = self._actions.functions.get(index)
            if function is None or transition.timeout is not None:
                return None
        elif transition.role is not Role.PLAIN:
            return None
        end = rule.transitions[last]
        arcs = (*compiled.inputs[index], *compiled.outputs[last])
        contended = rule.enabling.contended[index]
        if sum(map(len, contended)) > _MOST_RIVALS:
            return None
        rivals = tuple(dict.fromkeys(rival for sharing in contended for rival in sharing if rival != index))
        if (
            end.emit
            or end.remote_outputs
            or not all(weight == 1 and plain[place] for place, weight in arcs)
            or not all(self._contends_by_weight(rule.transitions[r], transition) for r in (index, *rivals))
            or any(rule.net.places[place].data_object for place in end.outputs)
        ):
            return None
        inputs = tuple((place, consumers[place]) for place, _ in compiled.inputs[index])
        return _Quick(inputs, rivals, tuple((place, consumers[place]) for place, _ in compiled.outputs[last]), function)

    @staticmethod
    def _contends_by_weight(rival: Transition, transition: Transition) -> bool:
        return rival.symbol is None and rival.strategy is None and rival.priority == transition.priority
