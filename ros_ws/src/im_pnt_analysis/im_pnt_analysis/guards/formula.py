"""Guards as formulas of z3: values of a command that stay the same, and conditions that may change at any time."""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from im_core.errors import quoted_text
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.inference import Meanings, infer
from im_pnt.expression.syntax import Binary, Call, Field, Item, Listing, Literal, Name, Node, Unary, shown
from im_pnt.expression.template import OPENS, nodes, references
from im_pnt.expression.types import ValueKind
from im_pnt.model.arguments import Argument, ArgumentSchema
from im_pnt.model.net import Guard

_NUMBERS = (ValueKind.NUMBER, ValueKind.INTEGER)
_CANCELLED = "cancelled"
_ANOTHER = "another text"

Term = tuple[Any, Any]
"""A value and the condition that it exists, both of z3."""


class _UndecidedError(Exception):
    """Error: an expression counts as a condition that may change at any time."""


class Formulas:
    """Formulas of the guards for one command or service.

    A value of unknown type counts as what it is compared with. Not decided are comparisons of texts by order, roots and
    the like: a comparison with one in it counts as what may change.

    Args:
        z3: The module.
        schema: Arguments of the command; None: anything.
        symbol: Symbol of the command; empty for a service, which any command may ask for.
        answered: Transitions whose answers are there; a value of another answer may be missing.
        stored: Data objects that stay as they are, for the net alone stores them.
        meanings: Types of names.
        whole: Whether a number of unknown type is a whole one.

    Attributes:
        changing: What may change at any time, by its text.
        uncertain: Whether a number of unknown type occurred.
    """

    def __init__(
        self,
        z3: Any,
        schema: ArgumentSchema | None,
        symbol: str,
        answered: frozenset[str],
        stored: frozenset[str],
        meanings: Meanings,
        whole: bool,
    ) -> None:
        self._z3, self._schema, self._answered, self._stored = z3, schema, answered, stored
        self._meanings, self._whole, self._symbol = meanings, whole, symbol
        self._values: dict[str, tuple[Any, ValueKind]] = {}
        self._there: dict[str, Any] = {}
        self._conditions: dict[str, Any] = {}
        self._limits: list[Any] = []
        self._texts: dict[str, int] = {}
        self.changing: dict[str, Any] = {}
        self.uncertain = False

    def holds(self, guard: Guard) -> Any:
        """Return the formula that says that a guard lets a token pass."""
        z3 = self._z3
        if guard.unless:
            return z3.Not(z3.Or([self.holds(each) for each in guard.unless]))
        if OPENS not in guard.name:
            # a wait that only a cancellation ends has no end of its own
            truth = z3.BoolVal(False) if guard.name == _CANCELLED else self._change(guard.name)
            return z3.Not(truth) if guard.negated else truth
        terms = [self._truth(node) for node in nodes(guard.name)]
        passes = z3.And([part for term in terms for part in term])  # without a value it counts as false
        return z3.Not(passes) if guard.negated else passes

    def limits(self) -> list[Any]:
        """Return the limits of the values that have occurred."""
        return list(self._limits)

    def told(self, model: Any) -> str:
        """Return the values of a model in words: ``x = 3``."""
        words = []
        for text, (value, kind) in sorted(self._values.items()):
            if self._is_true(model, self._conditions.get(text, True)):
                words.append(f"{text} = {self._word(model.eval(value, model_completion=True), kind)}")
        words += [f"no {text}" for text, there in sorted(self._there.items()) if not self._is_true(model, there)]
        return " and ".join(word.removeprefix("arguments.") for word in words)

    def _is_true(self, model: Any, condition: Any) -> bool:
        return condition is True or bool(self._z3.is_true(model.eval(condition, model_completion=True)))

    def _word(self, value: Any, kind: ValueKind) -> str:
        if kind is ValueKind.BOOLEAN:
            return str(self._z3.is_true(value)).lower()
        if kind is ValueKind.TEXT:
            known = {number: text for text, number in self._texts.items()}
            number = value.as_long()
            return quoted_text(known[number]) if number in known else _ANOTHER
        if not self._z3.is_rational_value(self._z3.simplify(self._z3.ToReal(value) if value.is_int() else value)):
            return str(value)
        number = Fraction(str(value.as_fraction())) if not value.is_int() else Fraction(value.as_long())
        return f"{float(number):.6g}"

    def _change(self, text: str) -> Any:
        return self.changing.setdefault(text, self._z3.Bool(f"change {text}"))

    def _truth(self, node: Node) -> Term:
        """Return the term of a condition."""
        z3 = self._z3
        match node:
            case Literal(bool() as value):
                return z3.BoolVal(value), z3.BoolVal(True)
            case Unary("not", of):
                value, there = self._truth(of)
                return z3.Not(value), there
            case Binary("and" | "or" as sign, left, right):
                (one, first), (other, second) = self._truth(left), self._truth(right)
                joined = z3.And(one, other) if sign == "and" else z3.Or(one, other)
                decided = z3.Not(one) if sign == "and" else one  # the right side is not looked at then
                return joined, z3.And(first, z3.Or(decided, second))
        try:
            if self._changes(node):
                raise _UndecidedError
            if isinstance(node, Binary):
                return self._compared(node)
            return self._value(node, ValueKind.BOOLEAN)
        except _UndecidedError:
            return self._change(shown(node)), z3.BoolVal(True)

    def _changes(self, node: Node) -> bool:
        return any(path[0] == "data" and path[1] not in self._stored for path in references(node))

    def _compared(self, node: Binary) -> Term:
        z3, sign, left, right = self._z3, node.sign, node.left, node.right
        if sign == "in":
            if not isinstance(right, Listing):
                raise _UndecidedError
            terms = [self._compared(Binary("==", left, each)) for each in right.elements]
            return z3.Or([term[0] for term in terms]), z3.And([term[1] for term in terms])
        kinds = {self._kind(left), self._kind(right)} - {ValueKind.ANY}
        numbers = kinds <= set(_NUMBERS)
        if sign not in ("==", "!="):
            if not numbers:
                raise _UndecidedError
            (one, first), (other, second) = self._number(left), self._number(right)
            value = {"<": one < other, "<=": one <= other, ">": one > other, ">=": one >= other}[sign]
            return value, z3.And(first, second)
        if not kinds or (len(kinds) > 1 and not numbers):
            raise _UndecidedError
        term = self._number if numbers else lambda each: self._value(each, next(iter(kinds)))
        (one, first), (other, second) = term(left), term(right)
        return (one == other if sign == "==" else one != other), z3.And(first, second)

    def _kind(self, node: Node) -> ValueKind:
        try:
            return infer(node, self._meanings).kind
        except ExpressionError:
            return ValueKind.ANY

    def _number(self, node: Node) -> Term:
        z3 = self._z3
        match node:
            case Literal(bool() | str()):
                raise _UndecidedError
            case Literal(value):
                return z3.RealVal(Fraction(value)), z3.BoolVal(True)
            case Unary("-", of):
                value, there = self._number(of)
                return -value, there
            case Binary("+" | "-" | "*" | "/" as sign, left, right):
                (one, first), (other, second) = self._number(left), self._number(right)
                if sign == "/":
                    return one / other, z3.And(first, second, other != 0)
                return {"+": one + other, "-": one - other, "*": one * other}[sign], z3.And(first, second)
            case Binary("mod", left, Literal(int() as divisor)) if (
                self._kind(left) is ValueKind.INTEGER and divisor > 0
            ):
                value, there = self._number(left)
                return z3.ToReal(z3.ToInt(value) % divisor), there
            case Call("min" | "max" | "abs" as function, several) if len(several) > 1 or function == "abs":
                return self._least([self._number(each) for each in several], function)
            case Call("len", (of,)):
                return self._length(of)
            case Field() | Item():
                return self._value(node, ValueKind.NUMBER)
        raise _UndecidedError

    def _least(self, terms: list[Term], function: str) -> Term:
        z3, (value, there) = self._z3, terms[0]
        if function == "abs":
            return z3.If(value < 0, -value, value), there
        for other, also in terms[1:]:
            value = z3.If((value < other) == (function == "min"), value, other)
            there = z3.And(there, also)
        return value, there

    def _length(self, of: Node) -> Term:
        if not isinstance(of, Field | Item):
            raise _UndecidedError
        _, there = self._place(of)
        value, new = self._variable(f"len({shown(of)})", ValueKind.INTEGER)
        if new:
            self._limits.append(value >= 0)
            argument = self._argument(of)
            if argument is not None and argument.length is not None:
                self._limits += [value >= argument.length[0], value <= argument.length[1]]
        return self._z3.ToReal(value), there

    def _value(self, node: Node, wanted: ValueKind) -> Term:
        """Return the term of a name that stays the same, or of a text or truth value as written."""
        z3 = self._z3
        match node:
            case Literal(str() as text) if wanted is ValueKind.TEXT:
                return z3.IntVal(self._number_of(text)), z3.BoolVal(True)
            case Literal(bool() as truth) if wanted is ValueKind.BOOLEAN:
                return z3.BoolVal(truth), z3.BoolVal(True)
            case Field() | Item():
                kind, there = self._place(node)
            case _:
                raise _UndecidedError
        if kind is ValueKind.ANY:
            self.uncertain |= wanted in _NUMBERS
            kind = ValueKind.INTEGER if wanted is ValueKind.NUMBER and self._whole else wanted
        if kind is not wanted and not (kind in _NUMBERS and wanted in _NUMBERS):
            raise _UndecidedError
        value, new = self._variable(shown(node), kind)
        self._conditions[shown(node)] = there
        if new and (argument := self._argument(node)) is not None:
            self._limits += list(self._allowed(argument, value, kind))
        if new and self._symbol and node == Field(Name("command"), "symbol"):
            self._limits.append(value == self._number_of(self._symbol))
        return (z3.ToReal(value) if kind is ValueKind.INTEGER else value), there

    def _number_of(self, text: object) -> int:
        return self._texts.setdefault(str(text), len(self._texts) + 1)

    def _variable(self, text: str, kind: ValueKind) -> tuple[Any, bool]:
        new = text not in self._values
        if new:
            make = {ValueKind.BOOLEAN: self._z3.Bool, ValueKind.NUMBER: self._z3.Real}.get(kind, self._z3.Int)
            self._values[text] = make(f"{kind.name} {text}"), kind
        value, known = self._values[text]
        if known is not kind:
            raise _UndecidedError
        return value, new

    def _place(self, node: Node) -> tuple[ValueKind, Any]:
        """Return the kind of a named value, and the condition for the value to exist."""
        z3, there = self._z3, self._z3.BoolVal(True)
        of = node
        while isinstance(of, Field | Item):
            if isinstance(of, Item):
                at, known = self._number(of.index)
                length, exists = self._length(of.of)
                there = z3.And(there, known, exists, at >= 0, at < length)
                return self._kind(node), there
            if isinstance(of.of, Name):
                break
            of = of.of
        root, name = next(iter(references(node)))[:2]
        if root == "answers" and name not in self._answered:
            text = f"answer of {name}"
            there = self._there.setdefault(text, z3.Bool(f"there is {text}"))
        return self._kind(node), there

    def _argument(self, node: Node) -> Argument | None:
        """Return the argument that a name or an element of a list belongs to, None for other values."""
        of = node
        while isinstance(of, Item):
            of = of.of
        match of:
            case Field(Name("arguments"), name) if self._schema is not None:
                return self._schema.arguments.get(name)
        return None

    def _allowed(self, argument: Argument, value: Any, kind: ValueKind) -> Iterator[Any]:
        z3 = self._z3
        if argument.choices:
            texts = kind is ValueKind.TEXT
            yield z3.Or([value == (self._number_of(each) if texts else each) for each in argument.choices])
        if kind in _NUMBERS:
            if argument.minimum is not None:
                yield value >= z3.RealVal(Fraction(argument.minimum))
            if argument.maximum is not None:
                yield value <= z3.RealVal(Fraction(argument.maximum))
