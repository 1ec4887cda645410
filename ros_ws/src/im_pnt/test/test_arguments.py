import contextlib

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError
from im_pnt.errors import NetFileError
from im_pnt.model.arguments import ArgumentSchema, ArgumentType
from im_pnt.netfile import parse_net
from support.process import Process

NET = """\
net: n
commands:
  pick:
    description: Picks a part.
    arguments:
      group: {type: string, choices: [left, right], default: left, help: which arm}
      width: {type: number, unit: m, minimum: 0.0, maximum: 0.1, help: of the part}
      poses: {type: numbers, unit: rad, minimum: -6.3, maximum: 6.3, length: 3, default: [0, 0, 0]}
      tries: {type: integer, minimum: 1, default: 3}
      dry: {type: boolean, default: false}
      names: {type: strings, length: [0, 2], default: []}
      note: {type: string, length: [0, 5], default: ""}
      extra: {type: object, default: {a: [1, null]}}
places: {idle: 1, asked: , done: , failed: }
services: {measure: {entry: asked, done: done, failed: failed, arguments: {camera: {type: string}}}}
transitions:
  pick: {symbol: pick, in: idle, out: idle, emit: pick_done}
  measure: {in: asked, out: done}
"""
SCHEMA = parse_net(NET).commands["pick"].arguments
GOOD = {"width": 0.05}


def test_what_is_not_given_has_its_default():
    assert SCHEMA.check(GOOD, "pick") == {
        "group": "left",
        "width": 0.05,
        "poses": [0, 0, 0],
        "tries": 3,
        "dry": False,
        "names": [],
        "note": "",
        "extra": {"a": [1, None]},
    }
    assert SCHEMA.check({"width": 0}, "pick")["width"] == 0, "a whole number is a number"


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({}, r"pick: argument width is missing, a number from 0 to 0.1 \[m\] \(of the part\)$"),
        ({"widht": 0.05}, r"pick has no argument 'widht' \(did you mean 'width'\?\)$"),
        ({"width": 0.2}, r"pick: argument width is 0.2, not a number from 0 to 0.1 \[m\]$"),
        ({"width": True}, "argument width is true, not a number"),
        ({"width": "0.05"}, "argument width is '0.05', not a number"),
        ({"width": float("nan")}, "argument width is nan, not a number"),
        ({"width": float("inf")}, "argument width is inf, not a number"),
        ({"width": 10**400}, "argument width is 1000.*, not a number"),
        ({"width": None}, "argument width is nothing, not a number"),
        ({**GOOD, "group": "lfet"}, r"argument group is 'lfet', not one of 'left', 'right' \(did you mean 'left'\?\)$"),
        ({**GOOD, "group": 1}, "argument group is 1, not one of 'left', 'right'$"),
        ({**GOOD, "poses": [0, 0]}, "argument poses has 2 elements, not 3$"),
        ({**GOOD, "poses": [0, 7.0, 0]}, r"argument poses\[1\] is 7.0, not a number from -6.3 to 6.3 \[rad\]$"),
        ({**GOOD, "poses": 0}, "argument poses is 0, not a list of 3 numbers"),
        ({**GOOD, "tries": 0}, "argument tries is 0, not a whole number >= 1$"),
        ({**GOOD, "tries": 2.0}, "argument tries is 2.0, not a whole number"),
        ({**GOOD, "tries": 2**63}, "argument tries is 9223372036854775808, not a whole number"),
        ({**GOOD, "dry": 1}, "argument dry is 1, not true or false$"),
        ({**GOOD, "names": ["a", "b", "c"]}, "argument names has 3 elements, not at most 2$"),
        ({**GOOD, "names": ["a", 2]}, r"argument names\[1\] is 2, not a text$"),
        ({**GOOD, "names": ["\ud800"]}, "half a character"),
        ({**GOOD, "note": "longer"}, "argument note has 6 characters, not at most 5$"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(given, sentence):
    with pytest.raises(DataError, match=sentence):
        SCHEMA.check(given, "pick")


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        (
            "  pick:\n",
            "  pikc:\n",
            r"net:3:3: commands.pikc: no transition begins a command .* 'pikc' \(did you mean 'pi",
        ),
        (
            "description: P",
            "descripton: P",
            r"net:4:5: commands.pick: 'descripton' is not a known key \(did you mean 'de",
        ),
        ("type: string, choices", "type: text, choices", r"net:6:21: commands.pick.arguments.group.type: .*'string'"),
        ("type: string, choices: [left", "choices: [left", "commands.pick.arguments.group: 'type' is missing"),
        ("choices: [left,", "choices: [3,", r"group.choices\[0\]: argument group is 3, not a text"),
        ("default: left", "default: lift", r"net:6:62: .*group.default: argument group is 'lift', not one of 'left'"),
        ("unit: m,", "unit: [m],", r"width.unit: a list is not a text"),
        ("minimum: 0.0", "minimum: low", r"width.minimum: .*valid number"),
        ("minimum: 0.0", "minimum: 1.0", r"width.maximum: 0.1 is less than the minimum 1"),
        ("type: boolean", "type: boolean, unit: m", "dry.unit: is for numbers; the argument is of type boolean"),
        ("type: boolean", "type: boolean, length: 1", "dry.length: is for lists and texts; .* type boolean"),
        ("length: 3", "length: -3", r"poses.length: \[-3, -3\] is no length"),
        ("length: 3", "length: [1, 2, 3]", r"\[1, 2, 3\] is no length: a number >= 0, or \[least, most\], is needed"),
        ("length: 3", "length: [3, 2]", r"\[3, 2\]: most 2 is less than least 3"),
        ("length: 3, default: [0, 0, 0]", "length: 3, default: [0]", "argument poses has 1 elements, not 3"),
        ("default: 3", "default: .inf", "tries.default: '.inf' is not a finite number"),
        ("camera: {type", "9camera: {type", "services.measure.arguments.9camera: '9camera' is not a name"),
        ("    arguments:\n", "    arguments: none\n    x:\n", "commands.pick.arguments: 'none' is not a mapping"),
    ],
)
def test_a_schema_that_makes_no_sense_is_refused_where_it_stands(find, replace, complaint):
    with pytest.raises(NetFileError, match=complaint):
        parse_net(NET.replace(find, replace))


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-9, 9)
    | st.sampled_from([0.0, 0.05, 0.1, 6.31, -1.5])
    | st.sampled_from(["left", "right", "", "abcdef"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "b"]), inner, max_size=2),
    max_leaves=4,
)


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.sampled_from([*SCHEMA.arguments, "other"]), json_values, max_size=4))
def test_the_json_schema_takes_what_is_taken_and_refuses_what_is_refused(given):
    validator = jsonschema.Draft202012Validator(SCHEMA.json_schema())
    whole = any(isinstance(v, float) and v.is_integer() for v in (given.get("tries"),))
    try:
        taken = SCHEMA.check(given, "pick")
    except DataError:
        assert whole or not validator.is_valid(given), "for JSON schema 2.0 is a whole number too"
    else:
        assert validator.is_valid(given)
        assert validator.is_valid(taken)
        assert SCHEMA.check(taken, "pick") == taken


@given(st.sampled_from(ArgumentType), json_values)
def test_nothing_but_a_refusal_comes_of_any_value(kind, value):
    text = NET.replace("dry: {type: boolean, default: false}", f"dry: {{type: {kind}}}")
    argument = parse_net(text).commands["pick"].arguments.arguments["dry"]
    with contextlib.suppress(DataError):
        assert argument.check(value) == value


def test_a_command_begins_with_what_its_net_declares():
    process = Process([parse_net(NET)])
    with pytest.raises(DataError, match=r"^command pick: argument width is missing"):
        process.command("n", "pick")
    process.command("n", "pick", width=0.05)
    assert process.results[0].success
    assert not process.exchange.nets["n"].jobs()


def test_a_request_is_refused_that_does_not_fit_when_it_arrives():
    asking = "net: a\nplaces: {p: 1, q: , r: }\ntransitions:\n"
    asking += "  ask: {in: p, out: q, request: {to: n.measure, build: build}, on_failure: r}\n"
    for built, ends in (({"camera": "wall"}, "q"), ({"camera": 3}, "r"), ({}, "r")):
        process = Process([parse_net(NET), parse_net(asking)], {"build": lambda ctx, built=built: built})
        process.pump()
        assert process.marking("a") == {ends: 1}


def test_a_schema_without_arguments_takes_none():
    with pytest.raises(DataError, match=r"^x has no argument 'y'; it takes none$"):
        ArgumentSchema().check({"y": 1}, "x")
