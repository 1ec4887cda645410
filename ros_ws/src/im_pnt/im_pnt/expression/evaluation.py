"""Values of expressions: every one comes to an end, with a value or with one sentence."""

import json
import math
from collections.abc import Callable
from typing import cast

from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.syntax import Binary, Call, Field, Item, Listing, Literal, Name, Node, Unary, shown

LARGEST = 2**63
"""No number is as large."""

Lookup = Callable[[str, str], object]
"""Returns the value of a name, by its root and what follows it, if anything; raises ExpressionError where none is."""


def evaluate(node: Node, lookup: Lookup) -> object:
    """Return the value of an expression, as JSON data.

    Raises:
        ExpressionError: It has none: a value is missing, or of another type, or a number is divided by 0.
    """
    match node:
        case Literal(value):
            return value
        case Listing(elements):
            return [evaluate(each, lookup) for each in elements]
        case Field(Name(root), name):
            return lookup(root, name)
        case Field(of, name):
            return _field(of, evaluate(of, lookup), name)
        case Item(of, index):
            return _item(of, evaluate(of, lookup), index, evaluate(index, lookup))
        case Unary("-", of):
            return _bounded(-_number(of, evaluate(of, lookup)), node)
        case Unary(_, of):
            return not _truth(of, evaluate(of, lookup))
        case Binary("and", left, right):
            return _truth(left, evaluate(left, lookup)) and _truth(right, evaluate(right, lookup))
        case Binary("or", left, right):
            return _truth(left, evaluate(left, lookup)) or _truth(right, evaluate(right, lookup))
        case Binary(sign, left, right):
            return _binary(node, sign, evaluate(left, lookup), evaluate(right, lookup))
        case Call("any", (of, condition)):
            return _any(of, evaluate(of, lookup), condition, lookup)
        case Call(function, arguments):
            return _call(node, function, [evaluate(each, lookup) for each in arguments])
        case Name(root):
            return lookup(root, "")


def _any(of: Node, elements: object, condition: Node, lookup: Lookup) -> bool:
    if not isinstance(elements, list):
        raise ExpressionError(f"{shown(of)} is {_told(elements)}, not a list")

    def holds(element: object) -> bool:
        def found(root: str, name: str) -> object:
            if root != "item":
                return lookup(root, name)
            return _field(Name(root), element, name) if name else element

        return _truth(condition, evaluate(condition, found))

    return any(holds(each) for each in elements)


def as_text(value: object) -> str:
    """Return a value in the form within a text."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or value is None:
        return "" if value is None else str(value).lower()
    return repr(value) if isinstance(value, int | float) else json.dumps(value)


def _told(value: object) -> str:
    if isinstance(value, dict):
        return "a message" if value else "empty"
    return "a list" if isinstance(value, list) else f"'{as_text(value)[:60]}'"


def _number(node: Node, value: object) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ExpressionError(f"{shown(node)} is {_told(value)}, not a number")
    return value


def _truth(node: Node, value: object) -> bool:
    if not isinstance(value, bool):
        raise ExpressionError(f"{shown(node)} is {_told(value)}, neither true nor false")
    return value


def _bounded(value: float, node: Node) -> int | float:
    if not -LARGEST < value < LARGEST:
        raise ExpressionError(f"{shown(node)} is beyond {LARGEST:.0e}, or no number")
    return value


def _field(of: Node, value: object, name: str) -> object:
    if not isinstance(value, dict) or name not in value:
        raise ExpressionError(f"{shown(of)} is {_told(value)}, without a field '{name}'")
    return cast("dict[str, object]", value)[name]


def _item(of: Node, value: object, index: Node, number: object) -> object:
    if not isinstance(value, list):
        raise ExpressionError(f"{shown(of)} is {_told(value)}, not a list")
    if isinstance(number, bool) or not isinstance(number, int):
        raise ExpressionError(f"{shown(index)} is {_told(number)}, not a whole number")
    if not 0 <= number < len(value):
        raise ExpressionError(f"{shown(of)} has {len(value)} elements, and no element {number}; the first is 0")
    return cast("list[object]", value)[number]


def _binary(node: Binary, sign: str, left: object, right: object) -> object:
    if sign in ("==", "!="):
        return _equal(left, right) == (sign == "==")
    if sign == "in":
        if isinstance(right, str) and isinstance(left, str):
            return left in right
        if not isinstance(right, list):
            raise ExpressionError(f"{shown(node.right)} is {_told(right)}, which has no elements")
        return any(_equal(left, each) for each in right)
    if sign in ("<", "<=", ">", ">=") and isinstance(left, str) and isinstance(right, str):
        return _ordered(sign, left < right, left == right)
    one, other = _number(node.left, left), _number(node.right, right)
    if sign in ("<", "<=", ">", ">="):
        return _ordered(sign, one < other, one == other)
    return _bounded(_reckoned(node, sign, one, other), node)


def _ordered(sign: str, less: bool, equal: bool) -> bool:
    return {"<": less, "<=": less or equal, ">": not less and not equal, ">=": not less}[sign]


def _reckoned(node: Node, sign: str, one: float, other: float) -> float:
    if sign == "+":
        return one + other
    if sign == "-":
        return one - other
    if sign == "*":
        return one * other
    if other == 0:
        raise ExpressionError(f"{shown(node)} divides by 0")
    try:
        return one / other if sign == "/" else one % other
    except OverflowError:
        raise ExpressionError(f"{shown(node)} is beyond {LARGEST:.0e}") from None


def _equal(one: object, other: object) -> bool:
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    return one == other


def _call(node: Call, function: str, values: list[object]) -> object:
    first = values[0]
    if function == "len":
        if not isinstance(first, list | str):
            raise ExpressionError(f"{shown(node.arguments[0])} is {_told(first)}, which has no length")
        return len(first)
    if function in ("min", "max"):
        several = first if len(values) == 1 and isinstance(first, list) else values
        numbers = [_number(node, each) for each in several]
        if not numbers:
            raise ExpressionError(f"{shown(node)} needs at least one value; the list is empty")
        return min(numbers) if function == "min" else max(numbers)
    numbers = [_number(each, value) for each, value in zip(node.arguments, values, strict=True)]
    return _bounded(_computed(node, function, numbers), node)


def _computed(node: Node, function: str, numbers: list[int | float]) -> int | float:
    number = numbers[0]
    if function == "abs":
        return abs(number)
    if function == "round":
        return round(number) if len(numbers) == 1 else round(float(number), _digits(node, numbers[1]))
    if function == "sqrt":
        if number < 0:
            raise ExpressionError(f"{shown(node)} is the root of {number}, which is less than 0")
        return math.sqrt(number)
    return math.sin(number) if function == "sin" else math.cos(number)


def _digits(node: Node, digits: float) -> int:
    if not isinstance(digits, int) or not -20 <= digits <= 20:
        raise ExpressionError(f"{shown(node)} has {digits} digits; a whole number from -20 to 20 is allowed")
    return digits
