"""Resources used by transitions, and the holders: read from net files, for each choice of deciding arguments.

A command holds what it ``needs``, and a request what its service says that it ``acts_on``: who asks is to hold that,
and so on, up to the net that has the places of these resources and takes their tokens.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import evaluate
from im_pnt.expression.template import OPENS, nodes
from im_pnt.model.action import RequestAction
from im_pnt.model.arguments import ArgumentSchema
from im_pnt.model.net import Guard, Net, Transition
from im_pnt.model.resource_use import Values, choices_of, filled, named_arguments, possible, shown, values_of


@dataclass(frozen=True)
class Work:
    """Command or request of a net, with a choice of the arguments decisive for the resources.

    Attributes:
        kind: Symbol of the command, or name of the service.
        is_request: Whether it is a request.
        choice: Those arguments.
        values: What its arguments may be.
        held: What it holds; what the choice does not tell, such as the elements of a list, as it is written.
    """

    kind: str
    is_request: bool
    choice: Mapping[str, object] = field(hash=False)
    values: Values = field(hash=False)
    held: frozenset[str]

    def __str__(self) -> str:
        chosen = ", ".join(f"{name}={shown(value)}" for name, value in self.choice.items())
        if not self.kind:
            return "a command of another net, whose tokens come here,"
        name = f"request {self.kind}" if self.is_request else f"command {self.kind}"
        return f"{name} with {chosen}" if chosen else name

    def may_pass(self, guard: Guard | None) -> bool:
        """Return whether an enabling function may let the work pass."""
        if guard is None or OPENS not in guard.name:
            return True

        def lookup(root: str, name: str) -> object:
            if root != "arguments" or name not in self.choice:
                raise ExpressionError("the value is not known before the run")
            return self.choice[name]

        try:
            return all(evaluate(node, lookup) is not guard.negated for node in nodes(guard.name))
        except ExpressionError:
            return True


def works_of(net: Net) -> Iterator[Work]:
    """Yield the possible commands and requests of a net, one for each choice."""
    for service in net.services.values():
        yield from _works(service.name, True, service.arguments, service.acts_on or ())
    for symbol in net.symbols():
        begins = any(t.symbol == symbol and t.symbol_of is None for t in net.transitions.values())
        declared = net.commands.get(symbol)
        if begins and declared is None:
            yield Work(symbol, False, {}, {}, frozenset())
        elif begins and declared is not None:
            yield from _works(symbol, False, declared.arguments, declared.needs)


def _works(kind: str, is_request: bool, schema: ArgumentSchema | None, texts: Sequence[str]) -> Iterator[Work]:
    for choice in choices_of(schema, named_arguments(texts)):
        values = {**values_of(schema), **{name: frozenset({shown(value)}) for name, value in choice.items()}}
        chosen = choice.keys()
        held = (filled(text, choice) if chosen >= set(named_arguments([text])) else text for text in texts)
        yield Work(kind, is_request, choice, values, frozenset(held))


NOBODY = Work("", False, {}, {}, frozenset())
"""Stands for nobody, of whose arguments nothing is known."""

VISIT = Work("", False, {}, {}, frozenset())
"""Stands for commands and requests whose tokens come from other nets: nothing is known of what they hold."""


class UntoldError(Exception):
    """Error: the resources of an action are undecided; gives the reason."""


class Acting:
    """Resources used by the transitions of some nets."""

    def __init__(self, nets: Sequence[Net]) -> None:
        self._nets = {net.name: net for net in nets}

    def acts_on(self, transition: Transition, work: Work) -> frozenset[str]:
        """Return the possible resources of a transition's action.

        Raises:
            UntoldError: It is not told by the net files.
        """
        action = transition.action
        said = {text: text for text in transition.acts_on or ()}
        found = self._said(said, work, work.values, f"of '{transition.origin}'")
        if isinstance(action, RequestAction) and not (transition.acts_on is not None and action.build):
            found |= self._asked(action, work)
        return found

    def _asked(self, action: RequestAction, work: Work) -> frozenset[str]:
        texts, schema = self._offered(action)
        if not texts:
            return frozenset()
        what = f"{action.net}.{action.service}"
        values = values_of(schema)
        if action.build is None:
            for name, argument in ({} if schema is None else schema.arguments).items():
                if not action.fields:
                    given = work.values.get(name)
                elif name in action.fields:
                    given = possible(action.fields[name], work.values)
                else:
                    given = possible(argument.default, {})
                values[name] = given if given is not None else values[name]
        made = f", whose arguments '{action.build}' makes" if action.build else ""
        return self._said({text: _as_given(text, action) for text in texts}, work, values, f"of {what}{made}")

    def _offered(self, action: RequestAction) -> tuple[Sequence[str], ArgumentSchema | None]:
        """Return the resources of a service, or of a command of another net, and the arguments."""
        net = self._nets.get(action.net)
        if net is not None and action.service in net.services:
            service = net.services[action.service]
            return service.acts_on or (), service.arguments
        if net is not None and action.service in net.commands:
            declared = net.commands[action.service]
            return declared.needs, declared.arguments
        return (), None

    def _said(self, texts: Mapping[str, str | None], work: Work, values: Values, of: str) -> frozenset[str]:
        """Return the meaning of texts.

        Args:
            texts: Each with what it is in the arguments of the work, where that is known.
            work: For whom.
            values: What the arguments in the texts may be.
            of: Where they stand.

        Raises:
            UntoldError: One may be anything.
        """
        found: frozenset[str] = frozenset()
        for text, own in texts.items():
            each = frozenset({own}) if own is not None and own in work.held else possible(text, values)
            if each is None:
                raise UntoldError(f"'{text}' {of} may be anything: declare `choices` of its arguments, or `acts_on`")
            found |= each - {""}
        return found


def _as_given(text: str, action: RequestAction) -> str | None:
    """Return a text of the callee in the arguments of the caller; None where undecided."""
    names = named_arguments([text])
    if action.build is None and not action.fields:
        return text
    given = {name: action.fields.get(name) for name in names}
    return filled(text, given) if all(isinstance(value, str) for value in given.values()) else None
