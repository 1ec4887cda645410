"""What stands in ``$(...)`` of a template: whole numbers, parameters, ``+ - *``, ``mod`` and parentheses."""

import re
from collections.abc import Mapping

from im_core.errors import nearest
from im_pnt.expression.errors import ExpressionError

Parameter = int | str
_TOKEN = re.compile(r"\s*(?:([0-9]{1,9})|([A-Za-z_][A-Za-z0-9_]*)|([-+*()]))")
_LARGEST = 10**9
_LONGEST = 200


def substitute(text: str, values: Mapping[str, Parameter]) -> str:
    """Replaces every ``$(...)`` of a text by its value.

    Raises:
        ExpressionError: One is not closed, or cannot be evaluated.
    """
    done: list[str] = []
    at = 0
    while (begin := text.find("$(", at)) >= 0:
        end, depth = begin + 2, 1
        while depth and end < len(text):
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        if depth:
            raise ExpressionError(f"'{text[begin : begin + 40]}' has no closing parenthesis")
        done += [text[at:begin], str(evaluate(text[begin + 2 : end - 1], values))]
        at = end
    return "".join([*done, text[at:]])


def evaluate(text: str, values: Mapping[str, Parameter]) -> Parameter:
    """Evaluates an expression: a number, or the text of a parameter that stands alone.

    Raises:
        ExpressionError: It is none, or names what is not a parameter.
    """
    if len(text) > _LONGEST:
        raise ExpressionError(f"an expression of {len(text)} characters is longer than {_LONGEST}")
    alone = values.get(text.strip())
    return alone if alone is not None else _Parser(text, values).whole()


class _Parser:
    """Recursive descent; as deep as there are parentheses in a short text."""

    def __init__(self, text: str, values: Mapping[str, Parameter]) -> None:
        self._text, self._values, self._at = text, values, 0
        self._tokens: list[str] = []
        at = 0
        while text[at:].strip():
            match = _TOKEN.match(text, at)
            if not match:
                raise ExpressionError(f"'{text}': '{text[at:].strip()[0]}' is not allowed (numbers, names, + - * mod)")
            self._tokens.append(match.group(0).strip())
            at = match.end()

    def whole(self) -> int:
        value = self._remainder()
        if self._at < len(self._tokens):
            raise ExpressionError(f"'{self._text}': nothing should follow before '{self._tokens[self._at]}'")
        return value

    def _next(self, *wanted: str) -> str | None:
        if self._at < len(self._tokens) and (not wanted or self._tokens[self._at] in wanted):
            self._at += 1
            return self._tokens[self._at - 1]
        return None

    def _remainder(self) -> int:
        """``i + 1 mod n`` is what it is in print: the remainder of the whole sum."""
        value = self._sum()
        while self._next("mod"):
            divisor = self._sum()
            if divisor < 1:
                raise ExpressionError(f"'{self._text}': mod {divisor} is not >= 1")
            value %= divisor
        return value

    def _sum(self) -> int:
        value = self._product()
        while sign := self._next("+", "-"):
            value = self._bounded(value + self._product() if sign == "+" else value - self._product())
        return value

    def _product(self) -> int:
        value = self._factor()
        while self._next("*"):
            value = self._bounded(value * self._factor())
        return value

    def _factor(self) -> int:
        token = self._next()
        if token == "-":
            return -self._factor()
        if token == "(":
            value = self._remainder()
            if self._next(")") is None:
                raise ExpressionError(f"'{self._text}' has no closing parenthesis")
            return value
        if token is None or token in "+*)" or token == "mod":
            raise ExpressionError(f"'{self._text}': a number or a parameter is missing")
        if token.isdigit():
            return int(token)
        if token not in self._values:
            raise ExpressionError(f"'{self._text}': there is no parameter '{token}'{nearest(token, self._values)}")
        found = self._values[token]
        if not isinstance(found, int):
            raise ExpressionError(f"'{self._text}': parameter {token} is '{found}', which is no number to reckon with")
        return found

    def _bounded(self, value: int) -> int:
        if abs(value) > _LARGEST:
            raise ExpressionError(f"'{self._text}' goes beyond {_LARGEST}")
        return value
