"""Use of resources of the cell, as declared by a net file: names of resources, with arguments inside.

Where it is not told which of several values an argument has, it may have each of them.
"""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence

from im_pnt.errors import NetError
from im_pnt.model.action import GoalAction, ServiceAction, TopicAction
from im_pnt.model.arguments import ArgumentSchema, ArgumentType
from im_pnt.model.net import Net

Values = Mapping[str, frozenset[str] | None]
"""For arguments what they, or each of their elements, may be; None: anything."""

_REFERENCE = re.compile(r"\$\{\s*arguments\.(\w+)\s*\}")
_MOST = 1000
"""Texts that one text may stand for."""


def named_arguments(texts: Sequence[str]) -> list[str]:
    """Return the arguments in texts, each once."""
    return list(dict.fromkeys(name for text in texts for name in _REFERENCE.findall(text)))


def shown(value: object) -> str:
    """Return a value in the form within the name of a resource."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def filled(text: str, choice: Mapping[str, object]) -> str:
    """Return a text with the values of the arguments."""
    return _REFERENCE.sub(lambda match: shown(choice[match[1]]), text)


def possible(value: object, values: Values) -> frozenset[str] | None:
    """Return the possible texts of a value, or of each of the elements.

    Args:
        value: A value of a net file, perhaps with ``${arguments.NAME}`` in it.
        values: What the arguments may be.

    Returns:
        The texts; None where other expressions, or unknown arguments, leave it open.
    """
    if isinstance(value, list | tuple):
        parts = [possible(each, values) for each in value]
        return None if None in parts else frozenset().union(*(part for part in parts if part is not None))
    if not isinstance(value, str):
        return None if isinstance(value, dict) else frozenset({shown(value)})
    names = named_arguments([value])
    if "${" in _REFERENCE.sub("", value):
        return None
    options = [values.get(name) for name in names]
    known = [sorted(each) for each in options if each is not None]
    if len(known) < len(names):
        return None
    chosen = list(itertools.islice(itertools.product(*known), _MOST + 1))
    if len(chosen) > _MOST:
        return None
    return frozenset(filled(value, dict(zip(names, each, strict=True))) for each in chosen)


def values_of(schema: ArgumentSchema | None) -> dict[str, frozenset[str] | None]:
    """Return the possible values of arguments, by the declarations."""
    if schema is None:
        return {}
    values: dict[str, frozenset[str] | None] = {}
    for name, argument in schema.arguments.items():
        truths = (False, True) if argument.type is ArgumentType.BOOLEAN else ()
        choices = argument.choices or truths
        values[name] = frozenset(map(shown, choices)) if choices else None
    return values


def choices_of(schema: ArgumentSchema | None, names: Sequence[str]) -> Iterator[dict[str, object]]:
    """Yield the combinations of the choices of some arguments; an argument without choices is left out.

    Args:
        schema: What is declared of the arguments.
        names: Arguments that decide something.
    """
    known = {} if schema is None else schema.arguments
    deciding = [name for name in names if name in known and known[name].choices and not known[name].type.is_list]
    for chosen in itertools.product(*(known[name].choices for name in deciding)):
        yield dict(zip(deciding, chosen, strict=True))


def speaks_of_resources(net: Net) -> bool:
    """Return whether a net declares a need or use of any resource."""
    needs = (command.needs for command in net.commands.values())
    served = (service.acts_on for service in net.services.values())
    done = (transition.acts_on for transition in net.transitions.values())
    return any(itertools.chain(needs, served, done))


def untold(net: Net) -> Iterator[str]:
    """Yield one sentence for each transition with an outside effect and no declared use of resources.

    A function, or a request to another net, is looked at from where it is written; who calls a service, sends a goal
    or publishes a message is the only one to know what that moves.
    """
    for transition in net.transitions.values():
        if isinstance(transition.action, ServiceAction | GoalAction | TopicAction) and transition.acts_on is None:
            who = f"{net.place_of(transition)}transition {transition.name} of net {net.name}"
            yield f"{who} does not say what its {transition.action} acts on: declare `acts_on`, [] for nothing"


def require_told(net: Net) -> None:
    """Check whether a net declares the use of resources.

    Raises:
        NetError: A transition does not; the first that does not is named.
    """
    for sentence in untold(net):
        raise NetError(sentence, net=net.name)
