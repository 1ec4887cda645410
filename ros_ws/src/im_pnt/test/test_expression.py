"""Expressions: what is read, its type and its value, and that nothing but their own error ever comes of any text."""

import json
import math
import operator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import evaluate
from im_pnt.expression.inference import Meanings, infer
from im_pnt.expression.syntax import DEEPEST, LONGEST, parse, shown
from im_pnt.expression.template import filled, has_expressions, pieces, references
from im_pnt.expression.types import ANY, BOOLEAN, INTEGER, NUMBER, TEXT, NoTypes, ValueType, field_type, list_of

KINDS = {
    "width": NUMBER,
    "count": INTEGER,
    "dry": BOOLEAN,
    "group": TEXT,
    "poses": list_of(NUMBER, length=3),
    "names": list_of(TEXT),
    "extra": ANY,
}
GIVEN = {
    "width": 0.05,
    "count": 3,
    "dry": False,
    "group": "left",
    "poses": [0.0, 0.5, 1.0],
    "names": ["a", "b"],
    "extra": {"deep": [{"x": 7}]},
}


def kind_of(name: str) -> ValueType:
    if name not in KINDS:
        raise ExpressionError(f"there is no {name}")
    return KINDS[name]


def nothing(name: str) -> ValueType:
    raise ExpressionError(f"there is no {name}")


MEANINGS = Meanings(kind_of, nothing, nothing, NoTypes())


def look_up(root: str, name: str) -> object:
    if root != "arguments" or name not in GIVEN:
        raise ExpressionError(f"{root}.{name} is not there")
    return GIVEN[name]


def value(text: str) -> object:
    return evaluate(parse(text), look_up)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("7 - 2 - 1", 4),
        ("3 + 4 mod 5", 2),
        ("1 / 4", 0.25),
        ("-2 * -3", 6),
        ("--2", 2),
        ("-arguments.count", -3),
        ("2.5e1", 25.0),
        ("arguments.width * 2 > 0.05 and not arguments.dry", True),
        ("arguments.count == 3.0", True),
        ("true == 1", False),
        ("arguments.group in ['left', 'right']", True),
        ("arguments.group != 'right'", True),
        ("'ef' in arguments.group", True),
        ("3 in arguments.names", False),
        ("'abc' < 'abd'", True),
        ("arguments.poses[1 + 1]", 1.0),
        ("arguments.extra.deep[0].x", 7),
        ("min(3, arguments.count, 2) + max(arguments.poses)", 3.0),
        ("abs(-2) + len(arguments.names) + len('abc')", 7),
        ("round(2.7)", 3),
        ("round(2.123456, 2)", 2.12),
        ("sqrt(16)", 4.0),
        ("sin(0) + cos(0)", 1.0),
        ("any([1, 2, 3], item > 2)", True),
        ("any([1, 2, 3], item > arguments.count)", False),
        ("any([], item > 2)", False),
        ("any(arguments.extra.deep, item.x == 7)", True),
        ("any([1, 2], any([2, 3], item > 2) and item == 1)", True),
        ("false and 1 / 0 > 1", False),
        ("true or 1 / 0 > 1", True),
        ("not true or true", True),
        ("[1, 2.5]", [1, 2.5]),
        ("[]", []),
    ],
)
def test_what_an_expression_says(text, wanted):
    found = value(text)
    assert found == wanted
    assert type(found) is type(wanted)
    assert value(shown(parse(text))) == wanted, "what is shown means the same"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "a value is missing at its end"),
        ("1 +", "a value is missing at its end"),
        ("1 2", "nothing should follow before '2'"),
        ("(1", r"'\)' is missing"),
        ("[1", r"'\]' is missing"),
        ("argments.x", r"there is no value 'argments' \(did you mean 'arguments'"),
        ("arguments", "'arguments' alone is no value; say which, as in arguments.NAME"),
        ("arguments.", "the name of a field is missing"),
        ("arguments.1", "the name of a field is missing"),
        ("maxi(1)", r"there is no function 'maxi' \(did you mean 'max'"),
        ("sqrt(1, 2)", "sqrt takes 1 values, not 2"),
        ("len()", "len takes 1 values, not 0"),
        ("1 < 2 < 3", "two comparisons stand behind each other at '<'; join them with 'and'"),
        ("1 & 2", "'&' is not allowed here"),
        ('"a"', r"texts stand in '\.\.\.'"),
        ("and", "a value is missing before 'and'"),
        ("__import__('os')", "there is no function '__import__'"),
        ("1" * (LONGEST + 1), "is longer than 500"),
        ("(" * (DEEPEST + 1) + "1" + ")" * (DEEPEST + 1), "the expression nests deeper than 30"),
        ("-" * (DEEPEST + 1) + "1", "the expression nests deeper than 30"),
        ("not " * (DEEPEST + 1) + "true", "the expression nests deeper than 30"),
        ("1e999", "is too large"),
    ],
)
def test_what_is_no_expression(text, sentence):
    with pytest.raises(ExpressionError, match=sentence):
        parse(text)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("1 / (arguments.count - 3)", "divides by 0$"),
        ("1 mod (arguments.count - 3)", "divides by 0$"),
        ("arguments.poses[3]", "arguments.poses has 3 elements, and no element 3; the first is 0"),
        ("arguments.poses[-1]", "no element -1"),
        ("arguments.other", "arguments.other is not there"),
        ("answers.look.x", "answers.look is not there"),
        ("arguments.extra.x", "arguments.extra is a message, without a field 'x'"),
        ("arguments.extra + 1", "arguments.extra is a message, not a number"),
        ("arguments.group * 2", "arguments.group is 'left', not a number"),
        ("not arguments.count", "arguments.count is '3', neither true nor false"),
        ("sqrt(-1)", "is the root of -1, which is less than 0"),
        ("max([])", "needs at least one value; the list is empty"),
        ("9000000000000000000 * 9", "is beyond 9e"),
        ("1e300 * 1e300", "is beyond 9e"),
        ("any(3, item > 1)", "3 is '3', not a list"),
        ("any([1], item + 1)", "neither true nor false"),
        ("any([1], item.x > 1)", "item is '1', without a field 'x'"),
        ("round(1.5, 99)", "a whole number from -20 to 20"),
    ],
)
def test_what_has_no_value(text, sentence):
    with pytest.raises(ExpressionError, match=sentence):
        value(text)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("arguments.count + 1", INTEGER),
        ("arguments.count / 1", NUMBER),
        ("arguments.count + 1.0", NUMBER),
        ("round(arguments.width)", INTEGER),
        ("arguments.poses[0]", NUMBER),
        ("arguments.names", list_of(TEXT)),
        ("arguments.extra.x[3].y", ANY),
        ("arguments.count > 3 and arguments.dry", BOOLEAN),
        ("failure.code", TEXT),
        ("command.id", INTEGER),
        ("[1, 2.5]", list_of(NUMBER, length=2)),
    ],
)
def test_types_are_found(text, kind):
    assert infer(parse(text), MEANINGS) == kind


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("arguments.wdth", "there is no wdth"),
        ("arguments.group + 1", r"'\+' is for numbers; arguments.group is a text"),
        ("arguments.count and true", "'and' is for what is true or false; arguments.count is a whole number"),
        ("not arguments.group", "'not' is for what is true or false"),
        ("arguments.group > 1", "compares two numbers or two texts; arguments.group is a text and 1 is a whole number"),
        ("arguments.group == 1", "arguments.group is a text and 1 is a whole number; they are never equal"),
        ("arguments.dry == 1", "they are never equal"),
        ("1 in arguments.names", "1 is a whole number, and arguments.names is a list of texts; it is never in it"),
        ("'a' in arguments.count", "'in' looks into a list or a text; arguments.count is a whole number"),
        ("arguments.poses[5]", "it has no element 5, the first is 0"),
        ("arguments.poses[0.5]", "an index is a whole number; 0.5 is a number"),
        ("arguments.count[0]", "arguments.count is a whole number, not a list"),
        ("arguments.count.x", "arguments.count is a whole number, which has no field 'x'"),
        ("len(arguments.count)", "len is of a list or a text"),
        ("max(arguments.names)", "'max' is for numbers; arguments.names is a text"),
        ("min(arguments.count)", "min is of several numbers, or of a list"),
        ("[1, 'a']", "a list has elements of one type, not a whole number and a text"),
        ("item > 1", "item is an element in the second value of any"),
        ("any(arguments.names, item > 1)", "compares two numbers or two texts; item is a text"),
        ("any(arguments.count, true)", "any is of a list; arguments.count is a whole number"),
        ("failure.cod", r"failure has no field 'cod' \(did you mean 'code'"),
    ],
)
def test_mistakes_that_types_show(text, sentence):
    with pytest.raises(ExpressionError, match=sentence):
        infer(parse(text), MEANINGS)


ATOMS = [
    "1",
    "0",
    "2.5",
    "'a'",
    "true",
    "[]",
    "[1, 2]",
    *(f"arguments.{name}" for name in KINDS),
    "answers.a.b",
    "data.o.f",
]
expressions = st.recursive(
    st.sampled_from(ATOMS),
    lambda inner: st.one_of(
        st.tuples(
            inner, st.sampled_from(["+", "-", "*", "/", "mod", "<", "<=", "==", "!=", "in", "and", "or"]), inner
        ).map(" ".join),
        inner.map("({})".format),
        inner.map("not {}".format),
        inner.map("-{}".format),
        st.tuples(inner, st.integers(-1, 3)).map(lambda pair: f"{pair[0]}[{pair[1]}]"),
        inner.map("{}.deep".format),
        st.tuples(st.sampled_from(["min", "max", "abs", "round", "len", "sqrt"]), inner).map(
            lambda pair: f"{pair[0]}({pair[1]})"
        ),
    ),
    max_leaves=8,
)


@settings(max_examples=200, deadline=None)
@given(expressions | st.text(max_size=40) | st.text("()[].,+-*/'1a $}{", max_size=600))
def test_nothing_but_an_expression_error_comes_of_any_text(text):
    try:
        node = parse(text)
    except ExpressionError:
        return
    assert parse(shown(node)) == node or len(shown(node)) > LONGEST
    try:
        found = evaluate(node, look_up)
    except ExpressionError:
        return
    json.dumps(found, allow_nan=False)


@settings(max_examples=200, deadline=None)
@given(expressions)
def test_what_has_a_type_has_a_value_of_it_or_none(text):
    """An expression that passes the check fails only for what is not there or out of range, never for a wrong type."""
    try:
        node = parse(text)
        kind = infer(node, MEANINGS)
    except ExpressionError:
        return
    try:
        found = evaluate(node, look_up)
    except ExpressionError as error:
        said, wrong = str(error), ("not a number", "neither true", "not a list", "no length", "no elements")
        known = all(path[:2] != ("arguments", "extra") for path in references(node))
        if known and any(words in said for words in wrong):
            raise
        return
    if kind in (BOOLEAN, INTEGER, TEXT):
        assert type(found) is {BOOLEAN: bool, INTEGER: int, TEXT: str}[kind]
    elif kind == NUMBER:
        assert type(found) in (int, float)


@given(st.integers(-99, 99), st.integers(-99, 99), st.integers(1, 99), st.sampled_from("+-*"))
def test_reckoning_is_that_of_numbers(a, b, c, sign):
    reckon = {"+": operator.add, "-": operator.sub, "*": operator.mul}[sign]
    assert value(f"{a} {sign} {b}") == reckon(a, b)
    assert value(f"{a} + {b} mod {c}") == (a + b) % c, "the remainder is that of the whole sum, as in templates"
    assert math.isclose(value(f"{a} / {c}"), a / c)


def test_a_text_that_is_one_expression_keeps_its_type_and_others_are_texts():
    given = {
        "number": "${arguments.count + 1}",
        "list": ["${arguments.poses}", 5, None, True],
        "text": "${arguments.group}_arm: ${arguments.width * 2} ${arguments.dry} ${arguments.names}",
        "brace": "${'}'}",
        "plain": "$(1) {x} $",
    }
    assert filled(given, look_up) == {
        "number": 4,
        "list": [[0.0, 0.5, 1.0], 5, None, True],
        "text": 'left_arm: 0.1 false ["a", "b"]',
        "brace": "}",
        "plain": "$(1) {x} $",
    }
    assert has_expressions(given)
    assert not has_expressions({"a": ["$x", 1, {"b": None}]})
    with pytest.raises(ExpressionError, match=r"'\$\{1 \+ 2' has no closing '\}'"):
        pieces("a ${1 + 2")


def test_the_ways_of_names_are_known():
    node = parse("answers.look.spots[arguments.count].x + max(data.d.a, [answers.look.n][0])")
    assert set(references(node)) == {
        ("arguments", "count"),
        ("answers", "look", "spots", "x"),
        ("data", "d", "a"),
        ("answers", "look", "n"),
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("double", "a number"),
        ("uint8", "a whole number from 0 to 255"),
        ("int16", "a whole number from -32768 to 32767"),
        ("boolean", "true or false"),
        ("string", "a text"),
        ("string<10>", "a text of at most 10 characters"),
        ("sequence<double>", "a list of numbers"),
        ("sequence<string<4>, 3>", "a list of at most 3 texts"),
        ("float[9]", "a list of 9 numbers"),
        ("geometry_msgs/Pose", "geometry_msgs/msg/Pose"),
        ("sequence<geometry_msgs/Pose, 2>", "a list of at most 2 geometry_msgs/msg/Pose"),
        ("octet", "anything"),
    ],
)
def test_types_of_fields_are_read(text, said):
    assert str(field_type(text)) == said
