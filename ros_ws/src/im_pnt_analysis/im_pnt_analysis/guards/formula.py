"""Guards as formulas of z3: values of a command that stay the same, and conditions that may change at any time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations
from typing import Any

from im_core.errors import quoted_text
from im_pnt.expression.inference import Meanings
from im_pnt.expression.syntax import Binary, Call, Field, Item, Listing, Literal, Name, Node, Unary, shown
from im_pnt.expression.template import OPENS, nodes, references
from im_pnt.expression.types import ValueKind, ValueType
from im_pnt.model.arguments import Argument, ArgumentSchema
from im_pnt.model.net import Guard
from im_pnt_analysis.guards.stored_values import Bounds, type_of

_NUMBERS = (ValueKind.NUMBER, ValueKind.INTEGER)
_VALUES = (ValueKind.BOOLEAN, ValueKind.TEXT, *_NUMBERS)
_MOST_ELEMENTS = 16
"""Elements of a list that are looked at one by one."""
_ROUNDING = Fraction(1, 2**52)
"""Greatest relative error of a sum, product or quotient of floating-point numbers (IEEE 754, double)."""
_CANCELLED = "cancelled"
_ANOTHER = "another text"

Term = tuple[Any, Any]
"""A value and the condition that it exists, both of z3."""


class _UndecidedError(Exception):
    """Error: an expression counts as a condition that may change at any time."""


@dataclass(frozen=True, slots=True)
class ValueKnowledge:
    """Knowledge of values at the place of guards.

    Attributes:
        schema: Arguments of the command; None: anything.
        symbol: Symbol of the command; empty for a service, which any command may ask for.
        answered: Transitions whose answers are there; a value of another answer may be missing.
        stored: Data objects that stay as they are, for the net alone stores them.
        bounds: Least and greatest values of their fields.
        meanings: Types of names.
        whole: Whether a number of unknown type is a whole one.
        rounded: Whether floating-point numbers are rounded as they are computed with.
    """

    schema: ArgumentSchema | None
    symbol: str
    answered: frozenset[str]
    stored: frozenset[str]
    bounds: Bounds
    meanings: Meanings
    whole: bool = False
    rounded: bool = False


class Formulas:
    """Formulas of the guards for one command or service.

    A value of unknown type counts as what it is compared with. Not decided are comparisons of texts by order, sines and
    the like: a comparison with one in it counts as what may change.

    Args:
        z3: The module.
        known: Knowledge of values.

    Attributes:
        changing: What may change at any time, by its text.
        uncertain: Whether a number of unknown type occurred.
        inexact: Whether floating-point numbers are computed with.
        granted: Values that are taken to be there, though nothing says so.
    """

    def __init__(self, z3: Any, known: ValueKnowledge) -> None:
        self._z3, self._known = z3, known
        self._true = z3.BoolVal(True)
        self._values: dict[str, tuple[Any, ValueKind]] = {}
        self._there: dict[str, Any] = {}
        self._conditions: dict[str, Any] = {}
        self._limits: list[Any] = []
        self._texts: dict[str, int] = {}
        self._lengths: dict[str, Any] = {}
        self._elements: dict[str, list[tuple[Any, Any]]] = {}
        self._rounded: dict[str, tuple[Any, Any]] = {}
        self.changing: dict[str, Any] = {}
        self.uncertain = self.inexact = False
        self.granted: set[str] = set()

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
        passes = self._all(*(part for term in terms for part in term))  # without a value it counts as false
        return z3.Not(passes) if guard.negated else passes

    def limits(self) -> list[Any]:
        """Return the limits of the values that have occurred."""
        z3, limits = self._z3, list(self._limits)
        for text, length in self._lengths.items():
            if f"len({text})" in self._values and text in self._values:
                value = self._values[text][0]
                for word, number in (*self._texts.items(), ("", self._number_of(""))):
                    limits.append(z3.Implies(value == number, length == len(word)))
                limits.append(z3.Implies(length == 0, value == self._number_of("")))
        for elements in self._elements.values():
            for (at, one), (where, other) in combinations(elements, 2):
                limits.append(z3.Implies(at == where, one == other))
        return limits

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
        if self._z3.is_algebraic_value(value):
            value = value.approx(12)
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
                return z3.BoolVal(value), self._true
            case Unary("not", of):
                value, there = self._truth(of)
                return z3.Not(value), there
            case Binary("and" | "or" as sign, left, right):
                (one, first), (other, second) = self._truth(left), self._truth(right)
                joined = z3.And(one, other) if sign == "and" else z3.Or(one, other)
                decided = z3.Not(one) if sign == "and" else one  # the right side is not looked at then
                return joined, first if second is self._true else self._all(first, z3.Or(decided, second))
        try:
            if self._changes(node):
                raise _UndecidedError
            if isinstance(node, Binary):
                return self._compared(node)
            if isinstance(node, Call) and node.function == "any":
                return self._any(*node.arguments)
            return self._value(node, ValueKind.BOOLEAN)
        except _UndecidedError:
            return self._change(shown(node)), self._true

    def _all(self, *conditions: Any) -> Any:
        """Return the conjunction of conditions, without those that are always true."""
        open_ones = [each for each in conditions if each is not self._true]
        return self._z3.And(open_ones) if len(open_ones) > 1 else (open_ones or [self._true])[0]

    def _changes(self, node: Node) -> bool:
        return any(path[0] == "data" and path[1] not in self._known.stored for path in references(node))

    def _compared(self, node: Binary) -> Term:
        z3, sign, left, right = self._z3, node.sign, node.left, node.right
        if sign == "in":
            if not isinstance(right, Listing):
                return self._any(right, Binary("==", left, Name("item")))
            terms = [self._compared(Binary("==", left, each)) for each in right.elements]
            return z3.Or([term[0] for term in terms]), self._all(*(term[1] for term in terms))
        if sign in ("==", "!=") and (isinstance(left, Listing) or isinstance(right, Listing)):
            value, there = self._same_list(*((left, right) if isinstance(left, Listing) else (right, left)))
            return value if sign == "==" else z3.Not(value), there
        kinds = {self._kind(left), self._kind(right)} - {ValueKind.ANY}
        numbers = kinds <= set(_NUMBERS)
        if sign not in ("==", "!="):
            if not numbers:
                raise _UndecidedError
            (one, first), (other, second) = self._number(left), self._number(right)
            self._keep_order(left, one, right, other)
            value = {"<": one < other, "<=": one <= other, ">": one > other, ">=": one >= other}[sign]
            return value, self._all(first, second)
        if not kinds or not kinds <= set(_VALUES) or (len(kinds) > 1 and not numbers):
            raise _UndecidedError
        term = self._number if numbers else lambda each: self._value(each, next(iter(kinds)))
        (one, first), (other, second) = term(left), term(right)
        self._keep_order(left, one, right, other)
        return (one == other if sign == "==" else one != other), self._all(first, second)

    def _same_list(self, listing: Node, of: Node) -> Term:
        """Return the term of whether a list has the elements that are written."""
        z3 = self._z3
        if not isinstance(listing, Listing) or isinstance(of, Listing):
            raise _UndecidedError
        length, there = self._length(of)
        if self._type(of).kind is not ValueKind.LIST:
            raise _UndecidedError
        terms = [self._compared(Binary("==", Item(of, Literal(at)), each)) for at, each in enumerate(listing.elements)]
        return z3.And(length == len(terms), *(term[0] for term in terms)), there

    def _any(self, of: Node, condition: Node) -> Term:
        """Return the term of whether a condition holds for an element of a short list; the first one that does ends."""
        z3 = self._z3
        length, there = self._length(of)
        most = self._longest(of)
        if self._type(of).kind is not ValueKind.LIST or most is None or most > _MOST_ELEMENTS:
            raise _UndecidedError
        value, ended = z3.BoolVal(False), self._true
        for at in reversed(range(most)):
            one, known = self._truth_of(_with_item(condition, Item(of, Literal(at))))
            value, ended = (
                z3.And(length > at, z3.Or(one, value)),
                z3.Or(length <= at, z3.And(known, z3.Or(one, ended))),
            )
        return value, z3.And(there, ended)

    def _truth_of(self, node: Node) -> Term:
        """Return the term of a condition on an element; one that is not decided leaves the whole list undecided."""
        before = set(self.changing)
        term = self._truth(node)
        if new := self.changing.keys() - before:
            self.changing = {text: each for text, each in self.changing.items() if text not in new}
            raise _UndecidedError
        return term

    def _longest(self, of: Node) -> int | None:
        argument, kind = self._argument(of), self._type(of)
        if argument is not None and argument.length is not None:
            return argument.length[1]
        return kind.length if kind.length is not None else kind.longest

    def _kind(self, node: Node) -> ValueKind:
        return self._type(node).kind

    def _type(self, node: Node) -> ValueType:
        return type_of(node, self._known.meanings)

    def _number(self, node: Node) -> Term:
        z3 = self._z3
        match node:
            case Literal(bool() | str()):
                raise _UndecidedError
            case Literal(value):
                return z3.RealVal(Fraction(value)), self._true
            case Unary("-", of):
                value, there = self._number(of)
                return -value, there
            case Binary("+" | "-" | "*" | "/" as sign, left, right):
                (one, first), (other, second) = self._number(left), self._number(right)
                there = self._all(first, second, other != 0) if sign == "/" else self._all(first, second)
                exact = {"+": one + other, "-": one - other, "*": one * other}.get(sign)
                return self._as_computed(node, one / other if exact is None else exact), there
            case Binary("mod", left, Literal(int() as divisor)) if (
                self._kind(left) is ValueKind.INTEGER and divisor > 0
            ):
                value, there = self._number(left)
                return z3.ToReal(z3.ToInt(value) % divisor), there
            case Call("min" | "max" | "abs" as function, several) if len(several) > 1 or function == "abs":
                return self._least([self._number(each) for each in several], function)
            case Call("len", (of,)):
                return self._length(of)
            case Call("round", (of,)):
                value, there = self._number(of)
                whole = z3.ToInt(value + z3.Q(1, 2))
                tie = z3.And(z3.ToReal(whole) == value + z3.Q(1, 2), whole % 2 == 1)  # the even one of both
                return z3.ToReal(z3.If(tie, whole - 1, whole)), there
            case Call("sqrt", (of,)):
                value, there = self._number(of)
                root = z3.Real(f"root {shown(node)}")
                self._limits += [root >= 0, z3.Implies(value >= 0, root * root == value)]
                return self._as_computed(node, root), z3.And(there, value >= 0)
            case Field() | Item():
                return self._value(node, ValueKind.NUMBER)
        raise _UndecidedError

    def _as_computed(self, node: Node, exact: Any) -> Any:
        """Return the result of a computation; of floating-point numbers, if wanted, with the error of rounding."""
        if self._kind(node) is ValueKind.INTEGER:
            return exact
        self.inexact = True
        if not self._known.rounded:
            return exact
        text = shown(node)
        if text not in self._rounded:
            z3 = self._z3
            value = z3.Real(f"rounded {text}")
            self._rounded[text] = value, exact
            small, large = exact * z3.RealVal(1 - _ROUNDING), exact * z3.RealVal(1 + _ROUNDING)
            upwards = z3.And(value >= small, value <= large)
            self._limits.append(z3.If(exact >= 0, upwards, z3.And(value <= small, value >= large)))
        return self._rounded[text][0]

    def _keep_order(self, left: Node, one: Any, right: Node, other: Any) -> None:
        """Note that rounding keeps the order to a number that is none of a computation."""
        z3 = self._z3
        computed = [shown(node) in self._rounded for node in (left, right)]
        if computed.count(True) == 1:
            exact, known = (
                (self._rounded[shown(left)][1], other) if computed[0] else (self._rounded[shown(right)][1], one)
            )
            value = one if computed[0] else other
            self._limits += [z3.Implies(exact <= known, value <= known), z3.Implies(exact >= known, value >= known)]

    def _least(self, terms: list[Term], function: str) -> Term:
        z3, (value, there) = self._z3, terms[0]
        if function == "abs":
            return z3.If(value < 0, -value, value), there
        for other, also in terms[1:]:
            value = z3.If((value < other) == (function == "min"), value, other)
            there = self._all(there, also)
        return value, there

    def _length(self, of: Node) -> Term:
        if not isinstance(of, Field | Item):
            raise _UndecidedError
        _, there = self._place(of)
        value, new = self._variable(f"len({shown(of)})", ValueKind.INTEGER)
        if new:
            argument, kind = self._argument(of), self._type(of)
            least, most = (0, None) if isinstance(of, Item) or argument is None else argument.length or (0, None)
            if kind.length is not None:
                least = most = kind.length
            most = kind.longest if most is None else most
            self._limits.append(value >= least)
            if most is not None:
                self._limits.append(value <= most)
            if kind.kind is ValueKind.TEXT:
                self._lengths[shown(of)] = value
                self._value(of, ValueKind.TEXT)
        return self._z3.ToReal(value), there

    def _value(self, node: Node, wanted: ValueKind) -> Term:
        """Return the term of a name that stays the same, or of a text or truth value as written."""
        z3 = self._z3
        match node:
            case Literal(str() as text) if wanted is ValueKind.TEXT:
                return z3.IntVal(self._number_of(text)), self._true
            case Literal(bool() as truth) if wanted is ValueKind.BOOLEAN:
                return z3.BoolVal(truth), self._true
            case Field() | Item():
                kind, there = self._place(node)
            case _:
                raise _UndecidedError
        if kind is ValueKind.ANY:
            self.uncertain |= wanted in _NUMBERS
            kind = ValueKind.INTEGER if wanted is ValueKind.NUMBER and self._known.whole else wanted
        if kind is not wanted and not (kind in _NUMBERS and wanted in _NUMBERS):
            raise _UndecidedError
        value, new = self._variable(shown(node), kind)
        self._conditions[shown(node)] = there
        if new:
            self._limits += list(self._allowed(node, value, kind))
            if isinstance(node, Item):
                at, _ = self._number(node.index)
                self._elements.setdefault(f"{kind} {shown(node.of)}", []).append((at, value))
            if kind is ValueKind.TEXT and (argument := self._argument(node)) and argument.length:
                self._length(node)
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
        z3, there = self._z3, self._true
        of = node
        while isinstance(of, Field | Item):
            if isinstance(of, Item):
                at, known = self._number(of.index)
                length, exists = self._length(of.of)
                there = self._all(known, exists, at >= 0, at < length)
                return self._kind(node), there
            if isinstance(of.of, Name):
                break
            of = of.of
        root, name, *way = next(iter(references(node)))
        if root == "answers" and name not in self._known.answered:
            text = f"answer of {name}"
            there = self._there.setdefault(text, z3.Bool(f"there is {text}"))
        if root == "arguments" and (self._known.schema is None or way):
            self.granted.add(shown(node))
        return self._kind(node), there

    def _argument(self, node: Node) -> Argument | None:
        """Return the argument that a name or an element of a list belongs to, None for other values."""
        of = node
        while isinstance(of, Item):
            of = of.of
        match of:
            case Field(Name("arguments"), name) if self._known.schema is not None:
                return self._known.schema.arguments.get(name)
        return None

    def _allowed(self, node: Node, value: Any, kind: ValueKind) -> Iterator[Any]:
        """Yield the limits of a value: of an argument as declared, of a field by its type, of a counter as stored."""
        z3, argument, of = self._z3, self._argument(node), self._type(node)
        least: float | None = of.lowest
        most: float | None = of.highest
        if argument is not None:
            if argument.choices:
                texts = kind is ValueKind.TEXT
                yield z3.Or([value == (self._number_of(each) if texts else each) for each in argument.choices])
            least, most = argument.minimum, argument.maximum
        elif node == Field(Name("command"), "symbol") and self._known.symbol:
            yield value == self._number_of(self._known.symbol)
        elif isinstance(node, Field):
            path = next(iter(references(node)))
            low, high = self._known.bounds.get(path[1:], (None, None)) if path[0] == "data" else (None, None)
            least, most = least if low is None else low, most if high is None else high
        if kind in _NUMBERS:
            if least is not None:
                yield value >= z3.RealVal(Fraction(least))
            if most is not None:
                yield value <= z3.RealVal(Fraction(most))


def _with_item(node: Node, element: Node) -> Node:
    """Return a condition on ``item`` as one on an element of a list."""
    match node:
        case Name("item"):
            return element
        case Field(of, _) | Unary(_, of):
            return replace(node, of=_with_item(of, element))
        case Item(of, index):
            return Item(_with_item(of, element), _with_item(index, element))
        case Binary(sign, left, right):
            return Binary(sign, _with_item(left, element), _with_item(right, element))
        case Call("any", (of, condition)):
            return Call("any", (_with_item(of, element), condition))
        case Call(function, several):
            return Call(function, tuple(_with_item(each, element) for each in several))
        case Listing(several):
            return Listing(tuple(_with_item(each, element) for each in several))
    return node
