"""Types of expressions, from the meanings of names at the place; type errors are found at load."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from im_core.errors import nearest
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.syntax import Binary, Call, Field, Item, Listing, Literal, Name, Node, Unary, shown
from im_pnt.expression.types import ANY, BOOLEAN, INTEGER, NUMBER, TEXT, MessageTypes, ValueKind, ValueType, list_of

_FAILURE = {"code": TEXT, "message": TEXT}
_COMMAND = {"id": INTEGER, "symbol": TEXT}


@dataclass(frozen=True)
class Meanings:
    """Meanings of names at the place of an expression.

    Attributes:
        arguments: Type of an argument; raises ExpressionError where there is none.
        answers: Likewise of the answer of a transition.
        data: Likewise of a data object.
        types: Looks up the fields of messages.
        item: Type of the elements of a list, in a condition on these; None elsewhere.
    """

    arguments: Callable[[str], ValueType]
    answers: Callable[[str], ValueType]
    data: Callable[[str], ValueType]
    types: MessageTypes
    item: ValueType | None = None


def infer(node: Node, meanings: Meanings) -> ValueType:
    """Return the type of an expression.

    Raises:
        ExpressionError: A name is not known, or an operator cannot have what stands beside it.
    """
    match node:
        case Literal(value):
            return _literal(value)
        case Listing(elements):
            return list_of(_common([infer(each, meanings) for each in elements]), length=len(elements))
        case Field(Name(root), name) if root != "item":
            return _named(root, name, meanings)
        case Field(of, name):
            return _field(node, infer(of, meanings), name, meanings)
        case Item(of, index):
            return _item(of, infer(of, meanings), index, infer(index, meanings))
        case Unary("-", of):
            return _number(of, infer(of, meanings), "-")
        case Unary(sign, of):
            return _truth(of, infer(of, meanings), sign)
        case Binary(sign, left, right):
            return _binary(sign, left, infer(left, meanings), right, infer(right, meanings))
        case Call("any", (of, condition)):
            kind = infer(of, meanings)
            if kind.kind not in (ValueKind.LIST, ValueKind.ANY):
                raise ExpressionError(f"any is of a list; {shown(of)} is {kind}")
            return _truth(condition, infer(condition, replace(meanings, item=kind.element or ANY)), "any")
        case Call(function, arguments):
            return _call(function, arguments, [infer(each, meanings) for each in arguments])
        case Name("item"):
            if meanings.item is None:
                raise ExpressionError("item is an element in the second value of any(LIST, CONDITION) alone")
            return meanings.item
        case Name(root):
            raise ExpressionError(f"'{root}' alone is no value")


def _literal(value: bool | float | str) -> ValueType:
    if isinstance(value, bool):
        return BOOLEAN
    return TEXT if isinstance(value, str) else INTEGER if isinstance(value, int) else NUMBER


def _named(root: str, name: str, meanings: Meanings) -> ValueType:
    match root:
        case "arguments":
            return meanings.arguments(name)
        case "answers":
            return meanings.answers(name)
        case "data":
            return meanings.data(name)
    fields = _FAILURE if root == "failure" else _COMMAND
    if name not in fields:
        raise ExpressionError(f"{root} has no field '{name}'{nearest(name, fields)}")
    return fields[name]


def _field(node: Node, of: ValueType, name: str, meanings: Meanings) -> ValueType:
    if of.kind is ValueKind.ANY:
        return ANY
    if of.kind is not ValueKind.MESSAGE:
        what = shown(node.of) if isinstance(node, Field) else shown(node)
        raise ExpressionError(f"{what} is {of}, which has no field '{name}'")
    fields = meanings.types.fields(of.message)
    if fields is None:
        return ANY
    if name not in fields:
        raise ExpressionError(f"{of.message} has no field '{name}'{nearest(name, fields)}")
    return fields[name]


def _item(of: Node, kind: ValueType, index: Node, index_kind: ValueType) -> ValueType:
    if not index_kind.fits(INTEGER):
        raise ExpressionError(f"an index is a whole number; {shown(index)} is {index_kind}")
    if kind.kind is ValueKind.ANY:
        return ANY
    if kind.kind is not ValueKind.LIST or kind.element is None:
        raise ExpressionError(f"{shown(of)} is {kind}, not a list")
    number = index.value if isinstance(index, Literal) and isinstance(index.value, int) else 0
    if kind.length is not None and not 0 <= number < kind.length:
        raise ExpressionError(f"{shown(of)} is {kind}; it has no element {number}, the first is 0")
    return kind.element


def _number(node: Node, kind: ValueType, sign: str) -> ValueType:
    if not kind.is_number:
        raise ExpressionError(f"'{sign}' is for numbers; {shown(node)} is {kind}")
    return INTEGER if kind.kind is ValueKind.INTEGER else NUMBER


def _truth(node: Node, kind: ValueType, sign: str) -> ValueType:
    if not kind.fits(BOOLEAN):
        raise ExpressionError(f"'{sign}' is for what is true or false; {shown(node)} is {kind}")
    return BOOLEAN


def _binary(sign: str, left: Node, one: ValueType, right: Node, other: ValueType) -> ValueType:
    if sign in ("and", "or"):
        _truth(left, one, sign)
        return _truth(right, other, sign)
    if sign in ("+", "-", "*", "/", "mod"):
        whole = _number(left, one, sign) == _number(right, other, sign) == INTEGER
        return INTEGER if whole and sign != "/" else NUMBER
    if sign == "in":
        _require_member(left, one, right, other)
    elif sign in ("==", "!="):
        if not one.fits(other) and not other.fits(one):
            raise ExpressionError(f"{shown(left)} is {one} and {shown(right)} is {other}; they are never equal")
    elif not (one.is_number and other.is_number) and not (one.fits(TEXT) and other.fits(TEXT)):
        raise ExpressionError(
            f"'{sign}' compares two numbers or two texts; {shown(left)} is {one} and {shown(right)} is {other}"
        )
    return BOOLEAN


def _require_member(left: Node, one: ValueType, right: Node, other: ValueType) -> None:
    if other.kind is ValueKind.LIST and other.element is not None:
        if not one.fits(other.element) and not other.element.fits(one):
            raise ExpressionError(f"{shown(left)} is {one}, and {shown(right)} is {other}; it is never in it")
    elif other.kind is ValueKind.TEXT:
        if not one.fits(TEXT):
            raise ExpressionError(f"only a text can be in a text; {shown(left)} is {one}")
    elif other.kind is not ValueKind.ANY:
        raise ExpressionError(f"'in' looks into a list or a text; {shown(right)} is {other}")


def _call(function: str, nodes: tuple[Node, ...], kinds: list[ValueType]) -> ValueType:
    if function == "len":
        if kinds[0].kind not in (ValueKind.LIST, ValueKind.TEXT, ValueKind.ANY):
            raise ExpressionError(f"len is of a list or a text; {shown(nodes[0])} is {kinds[0]}")
        return INTEGER
    if function in ("min", "max") and len(kinds) == 1:
        kind = kinds[0]
        if kind.kind is ValueKind.ANY:
            return NUMBER
        if kind.kind is not ValueKind.LIST or kind.element is None:
            raise ExpressionError(f"{function} is of several numbers, or of a list; {shown(nodes[0])} is {kind}")
        return _number(nodes[0], kind.element, function)
    found = [_number(node, kind, function) for node, kind in zip(nodes, kinds, strict=True)]
    if function == "round":
        if len(found) == 2 and not kinds[1].fits(INTEGER):
            raise ExpressionError(f"round takes a whole number of digits; {shown(nodes[1])} is {kinds[1]}")
        return INTEGER if len(found) == 1 else NUMBER
    if function in ("sqrt", "sin", "cos"):
        return NUMBER
    return INTEGER if all(kind == INTEGER for kind in found) else NUMBER


def _common(kinds: list[ValueType]) -> ValueType:
    """Return the type of elements of a list."""
    if not kinds:
        return ANY
    for kind in kinds:
        if all(each.fits(kind) for each in kinds):
            return kind
    raise ExpressionError(f"a list has elements of one type, not {' and '.join(dict.fromkeys(map(str, kinds)))}")
