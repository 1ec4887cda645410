"""Syntax of ``${...}``: numbers, texts, names of values, operators and a few functions; parsed to a tree.

There are no loops and no calls of foreign code, and texts and nesting are bounded: whatever is read comes to an end.
From weak to strong: ``or``, ``and``, ``not``, comparisons and ``in``, ``mod`` (the remainder of the whole sum, as in
print), ``+ -``, ``* /``, the sign, and ``.field`` (``.'a.b'`` where its name is none of the language) and ``[index]``.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from im_core.errors import nearest, quoted_text, shortened
from im_pnt.expression.errors import ExpressionError

LONGEST = 500
"""Most characters of an expression."""

DEEPEST = 30
"""Most parentheses, signs and negations inside each other."""

ROOTS = ("arguments", "answers", "data", "failure", "command", "item")
"""Where names begin."""

FUNCTIONS = {"min": (1, 20), "max": (1, 20), "abs": (1, 1), "round": (1, 2), "len": (1, 1)}
FUNCTIONS |= {"sqrt": (1, 1), "sin": (1, 1), "cos": (1, 1), "any": (2, 2)}
"""Functions, with the least and greatest number of their arguments; in that of ``any``, ``item`` is an element."""

COMPARISONS = ("==", "!=", "<=", ">=", "<", ">", "in")
WORDS = ("and", "or", "not", "in", "mod", "true", "false")
_TOKEN = re.compile(
    r"\s*(?:(?P<number>[0-9]{1,19}(?:\.[0-9]{1,18})?(?:[eE][-+]?[0-9]{1,3})?)|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<text>'[^']*')|(?P<sign>==|!=|<=|>=|[-+*/<>()\[\],.]))"
)


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, a text, true or false."""

    value: bool | int | float | str


@dataclass(frozen=True, slots=True)
class Name:
    """Where a name begins: one of :data:`ROOTS`; or a parameter of a template."""

    root: str


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a value; its name stands in quotes where it has a dot, as that of a part of a subnet."""

    of: "Node"
    name: str


@dataclass(frozen=True, slots=True)
class Item:
    """An element of a list, counted from 0."""

    of: "Node"
    index: "Node"


@dataclass(frozen=True, slots=True)
class Unary:
    """``-`` or ``not``."""

    sign: str
    of: "Node"


@dataclass(frozen=True, slots=True)
class Binary:
    """An operator between two values."""

    sign: str
    left: "Node"
    right: "Node"


@dataclass(frozen=True, slots=True)
class Call:
    """One of :data:`FUNCTIONS`."""

    function: str
    arguments: tuple["Node", ...]


@dataclass(frozen=True, slots=True)
class Listing:
    """Written list."""

    elements: tuple["Node", ...]


Node = Literal | Name | Field | Item | Unary | Binary | Call | Listing


@lru_cache(maxsize=4096)
def parse(text: str, parameters: tuple[str, ...] | None = None) -> Node:
    """Parse an expression.

    Args:
        text: The expression.
        parameters: Its only names, as in ``$(...)`` of a template; None: names begin with one of :data:`ROOTS`.

    Raises:
        ExpressionError: It is none.
    """
    if len(text) > LONGEST:
        raise ExpressionError(f"an expression of {len(text)} characters is longer than {LONGEST}")
    return _Parser(text, parameters).whole()


def shown(node: Node) -> str:
    """Return a tree as an author would write the expression."""
    match node:
        case Literal(value):
            if isinstance(value, bool | str):
                return f"'{value}'" if isinstance(value, str) else str(value).lower()
            return repr(value) if value >= 0 else f"({value!r})"
        case Name(root):
            return root
        case Field(of, name):
            return f"{shown(of)}.{name}" if name.isidentifier() else f"{shown(of)}.'{name}'"
        case Item(of, index):
            return f"{shown(of)}[{shown(index)}]"
        case Unary(sign, of):
            return f"(not {shown(of)})" if sign == "not" else f"(-{shown(of)})"
        case Binary(sign, left, right):
            return f"({shown(left)} {sign} {shown(right)})"
        case Call(function, arguments):
            return f"{function}({', '.join(map(shown, arguments))})"
        case Listing(elements):
            return f"[{', '.join(map(shown, elements))}]"


def rebuilt(node: Node, change: Callable[[Node], Node]) -> Node:
    """Return a tree with the parts of its root changed."""
    match node:
        case Field(of, name):
            return Field(change(of), name)
        case Item(of, index):
            return Item(change(of), change(index))
        case Unary(sign, of):
            return Unary(sign, change(of))
        case Binary(sign, left, right):
            return Binary(sign, change(left), change(right))
        case Call(function, arguments):
            return Call(function, tuple(map(change, arguments)))
        case Listing(elements):
            return Listing(tuple(map(change, elements)))
    return node


class _Parser:
    """Recursive descent; as deep as :data:`DEEPEST` allows."""

    def __init__(self, text: str, parameters: tuple[str, ...] | None) -> None:
        self._text, self._parameters, self._at, self._depth = text, parameters, 0, 0
        self._tokens: list[tuple[str, str]] = []
        at = 0
        while text[at:].strip():
            match = _TOKEN.match(text, at)
            if match is None or match.lastgroup is None:
                odd = text[at:].strip()[0]
                hint = "; texts stand in '...'" if odd == '"' else ""
                raise self._error(
                    f"{odd!r} is not allowed here (numbers, names, 'texts', + - * / mod and or not in){hint}"
                )
            self._tokens.append((match.lastgroup, match.group(match.lastgroup)))
            at = match.end()

    def whole(self) -> Node:
        node = self._either()
        if self._at < len(self._tokens):
            raise self._error(f"nothing should follow before {quoted_text(self._tokens[self._at][1], 20)}")
        return node

    def _error(self, sentence: str) -> ExpressionError:
        return ExpressionError(f"{quoted_text(self._text, 40)}: {sentence}")

    def _next(self, *wanted: str) -> str | None:
        if self._at < len(self._tokens):
            kind, text = self._tokens[self._at]
            if kind in ("sign", "name") and text in wanted:
                self._at += 1
                return text
        return None

    def _inside(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._error(f"the expression nests deeper than {DEEPEST}, the most allowed")

    def _either(self) -> Node:
        self._inside()
        node = self._both()
        while self._next("or"):
            node = Binary("or", node, self._both())
        self._depth -= 1
        return node

    def _both(self) -> Node:
        node = self._negation()
        while self._next("and"):
            node = Binary("and", node, self._negation())
        return node

    def _negation(self) -> Node:
        if not self._next("not"):
            return self._comparison()
        self._inside()
        node = Unary("not", self._negation())
        self._depth -= 1
        return node

    def _comparison(self) -> Node:
        node = self._remainder()
        if (sign := self._next(*COMPARISONS)) is None:
            return node
        node = Binary(sign, node, self._remainder())
        if (more := self._next(*COMPARISONS)) is not None:
            raise self._error(f"two comparisons stand behind each other at '{more}'; join them with 'and'")
        return node

    def _remainder(self) -> Node:
        node = self._sum()
        while self._next("mod"):
            node = Binary("mod", node, self._sum())
        return node

    def _sum(self) -> Node:
        node = self._product()
        while sign := self._next("+", "-"):
            node = Binary(sign, node, self._product())
        return node

    def _product(self) -> Node:
        node = self._signed()
        while sign := self._next("*", "/"):
            node = Binary(sign, node, self._signed())
        return node

    def _signed(self) -> Node:
        if not self._next("-"):
            return self._part()
        self._inside()
        node = self._signed()
        self._depth -= 1
        if isinstance(node, Literal) and not isinstance(node.value, bool | str):
            return Literal(-node.value)
        return Unary("-", node)

    def _part(self) -> Node:
        node = self._atom()
        while sign := self._next(".", "["):
            if sign == "[":
                node = Item(node, self._either())
                self._close("]")
                continue
            kind, name = self._tokens[self._at] if self._at < len(self._tokens) else ("", "")
            if kind not in ("name", "text"):
                raise self._error("the name of a field is missing after '.'")
            self._at += 1
            node = Field(node, name[1:-1] if kind == "text" else name)
        if isinstance(node, Name) and self._parameters is None and node.root != "item":
            raise self._error(f"'{node.root}' alone is no value; say which, as in {node.root}.{_EXAMPLES[node.root]}")
        return node

    def _atom(self) -> Node:
        if self._at >= len(self._tokens):
            raise self._error("a value is missing at its end")
        kind, text = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            return Literal(self._number(text))
        if kind == "text":
            return Literal(text[1:-1])
        if text == "(":
            node = self._either()
            self._close(")")
            return node
        if text == "[":
            return Listing(self._list("]"))
        if kind == "name" and text not in WORDS:
            return self._called(text) if self._next("(") else self._named(text)
        if text in ("true", "false"):
            return Literal(text == "true")
        raise self._error(f"a value is missing before {quoted_text(text, 20)}")

    def _number(self, text: str) -> int | float:
        if text.isdigit():
            return int(text)
        number = float(text)
        if number in (float("inf"), float("-inf")):
            raise self._error(f"{shortened(text, 20)} is too large")
        return number

    def _named(self, text: str) -> Node:
        what, known = ("value", ROOTS) if self._parameters is None else ("parameter", self._parameters)
        if text not in known:
            raise self._error(f"there is no {what} {quoted_text(text, 20)}{nearest(text, known)}")
        return Name(text)

    def _called(self, function: str) -> Node:
        if function not in FUNCTIONS:
            raise self._error(f"there is no function {quoted_text(function, 20)}{nearest(function, FUNCTIONS)}")
        arguments = self._list(")")
        least, most = FUNCTIONS[function]
        if not least <= len(arguments) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            raise self._error(f"{function} takes {wanted} values, not {len(arguments)}")
        return Call(function, arguments)

    def _list(self, end: str) -> tuple[Node, ...]:
        if self._next(end):
            return ()
        nodes = [self._either()]
        while self._next(","):
            nodes.append(self._either())
        self._close(end)
        return tuple(nodes)

    def _close(self, end: str) -> None:
        if not self._next(end):
            raise self._error(f"'{end}' is missing")


_EXAMPLES = {
    "arguments": "NAME",
    "answers": "TRANSITION.field",
    "data": "OBJECT.field",
    "failure": "code",
    "command": "id",
    "item": "field",
}
