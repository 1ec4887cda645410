"""Values drawn for answers and arguments, and the shortest sequence of draws that still fails."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from random import Random

from im_core.errors import ImError
from im_pnt.expression.syntax import Binary, Call, Literal, Node, Unary
from im_pnt.expression.template import OPENS, Way, nodes, references
from im_pnt.expression.types import ANY, BOOLEAN, NUMBER, TEXT, MessageTypes, ValueKind, ValueType, list_of
from im_pnt.model.arguments import Argument, ArgumentType
from im_pnt.model.net import Net

_LITERAL = re.compile(r"'([^']*)'|(?<![\w.])([0-9]+(?:\.[0-9]+)?)")


class Draws:
    """Sequence of small numbers that decide all that is drawn in a run; 0 is the plainest.

    Args:
        given: The first numbers.
        dice: Draws further ones; None: they are 0.

    Attributes:
        taken: The numbers of the run.
    """

    def __init__(self, given: Sequence[int] = (), dice: Random | None = None) -> None:
        self._given, self._dice = given, dice
        self.taken: list[int] = []

    def pick(self, count: int) -> int:
        """Return a number from 0 to less than a count."""
        rank = len(self.taken)
        if rank < len(self._given):
            number = min(self._given[rank], count - 1)
        else:
            number = 0 if self._dice is None else self._dice.randrange(count)
        self.taken.append(number)
        return number


def shrink(taken: Sequence[int], fails: Callable[[Sequence[int]], Sequence[int] | None], tries: int = 400) -> list[int]:
    """Make a failing sequence of draws shorter, and its numbers smaller, while it fails.

    Args:
        taken: The sequence.
        fails: Runs with a sequence; returns the numbers that were taken where that fails, else None.
        tries: Runs at most.

    Returns:
        The least sequence that was found.
    """
    best = list(taken)

    def better(candidate: Sequence[int]) -> bool:
        nonlocal best, tries
        if tries <= 0 or _size(candidate) >= _size(best):
            return False
        tries -= 1
        found = fails(candidate)
        if found is None or _size(found) >= _size(best):
            return False
        best = list(found)
        return True

    progress = True
    while progress and tries > 0:
        progress = False
        for width in (16, 4, 1):
            at = 0
            while at < len(best):
                if not better(best[:at] + best[at + width :]):
                    at += width
                else:
                    progress = True
        for at in range(len(best)):
            for smaller in (0, 1, 2):
                if at < len(best) and smaller < best[at] and better([*best[:at], smaller, *best[at + 1 :]]):
                    progress = True
                    break
    return best


def _size(numbers: Sequence[int]) -> tuple[int, int, tuple[int, ...]]:
    used = list(numbers)
    while used and used[-1] == 0:  # the plainest is drawn anyway
        used.pop()
    return len(used), sum(used), tuple(used)


class ValueDraw:
    """Draw of values of types: plain ones, and those next to the literals of a net."""

    def __init__(self, nets: Sequence[Net], types: MessageTypes) -> None:
        literals = {literal for net in nets for literal in _literals(net)}
        numbers = sorted({each for each in literals if not isinstance(each, str)}, key=lambda each: (abs(each), each))
        near = [close for each in numbers for close in (each, each - 1, each + 1, -each)]
        self._numbers = list(dict.fromkeys([0, 1, *near]))
        self.texts = ["", *sorted(each for each in literals if isinstance(each, str) and each)]
        self._types = types
        self._used: dict[Way, ValueType] = {}
        for node in nodes([guard for net in nets for guard in net.guards()]):
            self._note_use(node, BOOLEAN)

    def argument(self, argument: Argument, draws: Draws) -> object:
        """Return a value that an argument may have."""
        limits = argument.limits().values()
        kind = argument.type.element
        if argument.choices:
            values: list[object] = list(argument.choices)
        elif argument.type is ArgumentType.OBJECT:
            values = [{}]
        elif kind is ArgumentType.BOOLEAN:
            values = [False, True]
        elif kind is ArgumentType.STRING:
            values = [*self.texts, "x", "x" * (argument.length or (1, 1))[0]]
        else:
            numbers = [*self._numbers, *limits]
            values = [int(each) if kind is ArgumentType.INTEGER else float(each) for each in numbers]
        if argument.type.is_list:
            least, most = argument.length or (0, 2)
            lengths = range(least, min(most, least + 9) + 1)
            one = [each for each in values if _fits(argument, [each] * lengths[-1]) or not lengths[-1]]
            count = lengths[draws.pick(len(lengths))]
            return [one[draws.pick(len(one))] for _ in range(count)]
        allowed = ([] if argument.required else [argument.default]) + [each for each in values if _fits(argument, each)]
        return allowed[draws.pick(len(allowed))]

    def fields(self, message: str, at: Way, ways: Sequence[Way], draws: Draws) -> dict[str, object]:
        """Return values for fields of a message.

        Args:
            message: Its type, as of :class:`~im_pnt.expression.types.MessageTypes`; empty: it is not known, and guards
                tell what they take its fields for.
            at: Names by which guards know it: ``answers`` and the transition.
            ways: Ways to the fields.
            draws: Draws.
        """
        known = self._known(message) if message else {}
        names = list(dict.fromkeys(way[0] for way in ways if way)) or list(known)
        below = {name: [way[1:] for way in ways if way[:1] == (name,)] for name in names}
        return {name: self._value(known.get(name, ANY), (*at, name), below[name], draws) for name in names}

    def _note_use(self, node: Node, wanted: ValueType) -> None:
        """Note what an expression takes names for."""
        match node:
            case Unary(sign, of):
                self._note_use(of, BOOLEAN if sign == "not" else NUMBER)
            case Binary("and" | "or", left, right):
                self._note_use(left, BOOLEAN)
                self._note_use(right, BOOLEAN)
            case Binary(_, left, right):
                values = [each.value for each in (left, right) if isinstance(each, Literal)]
                kind = NUMBER
                if values and isinstance(values[0], bool | str):
                    kind = TEXT if isinstance(values[0], str) else BOOLEAN
                self._note_use(left, kind)
                self._note_use(right, kind)
            case Call("any", (of, _)):
                self._note_use(of, list_of(NUMBER))
            case Call(_, several):
                for each in several:
                    self._note_use(each, NUMBER)
            case _:
                for path in references(node):
                    self._used.setdefault(path, wanted)

    def _known(self, message: str) -> Mapping[str, ValueType]:
        """Return the types of the fields of a message; none of one that is not installed."""
        try:
            return self._types.fields(message) or {}
        except ImError:
            return {}

    def _value(self, kind: ValueType, at: Way, ways: Sequence[Way], draws: Draws) -> object:
        deeper = [way for way in ways if way]
        kind = self._used.get(at, ANY) if kind == ANY else kind
        match kind.kind:
            case ValueKind.MESSAGE:
                return self.fields(kind.message, at, deeper, draws)
            case ValueKind.LIST:
                count = kind.length if kind.length is not None else (1, 2, 0)[draws.pick(3)]
                return [self._value(kind.element or ANY, at, ways, draws) for _ in range(count)]
            case ValueKind.BOOLEAN:
                return draws.pick(2) == 1
            case ValueKind.TEXT:
                return self.texts[draws.pick(len(self.texts))]
            case ValueKind.ANY if deeper:
                return self.fields("", at, deeper, draws)
        low, high = kind.lowest, kind.highest
        whole = kind.kind is ValueKind.INTEGER
        numbers = [int(each) if whole else float(each) for each in self._numbers]
        fitting = [each for each in numbers if (low is None or each >= low) and (high is None or each <= high)]
        return fitting[draws.pick(len(fitting))]


def _fits(argument: Argument, value: object) -> bool:
    try:
        argument.check(value)
    except ImError:
        return False
    return True


def _literals(net: Net) -> Iterable[float | str]:
    """Yield the numbers and texts in the expressions of guards."""
    for transition in net.transitions.values():
        guard = transition.guard.name if transition.guard is not None else ""
        for text, number in _LITERAL.findall(guard if OPENS in guard else ""):
            yield float(number) if number else text
