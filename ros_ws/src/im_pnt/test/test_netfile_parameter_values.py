"""Values of template parameters: each keeps its type, through lists, mappings and subnets in subnets."""

import pytest

from im_pnt.errors import NetFileError
from im_pnt.netfile import parse_net

GIVEN = "{vals: [0.1, 2, [true]], at: {x: 1.50, names: [a, '7']}, flag: false, num: 7, word: '7'}"
SENT = """{
      v: "$(vals)", deep: [{of: $(at)}], x: "$(at.x)", second: "$(at.names[1])", flag: "$(flag)", num: "$(num)",
      word: $(word), text: "n $(num)", within: [0, "$(vals)"]}"""
EXPECTED = {
    "v": [0.1, 2, [True]],
    "deep": [{"of": {"x": 1.5, "names": ["a", "7"]}}],
    "x": 1.5,
    "second": "7",
    "flag": False,
    "num": 7,
    "word": "7",
    "text": "n 7",
    "within": [0, 0.1, 2, [True]],
}
NET = f"""net: n
templates:
  leaf:
    parameters: [vals, at, flag, num, word]
    ports: {{in: a, out: b, on_failure: c}}
    transitions:
      ask: {{in: a, out: b, on_failure: c, request: {{to: other.x, arguments: {SENT}}}}}
  branch:
    parameters: [vals, at, flag, num, word]
    ports: {{in: a, out: b, on_failure: c}}
    transitions:
      leaf:
        use: leaf
        in: a
        out: b
        on_failure: c
        arguments:
          {{vals: "$(vals)", at: {{x: "$(at.x)", names: "$(at.names)"}}, flag: $(flag), num: "$(num)", word: "$(word)"}}
  copy:
    parameters: [vals, at, flag, num, word]
    transitions:
      ask: {{in: w, out: d, on_failure: f, request: {{to: other.x, arguments: {SENT}}}}}
places: {{idle: 1, w: , d: , f: }}
USE
transitions:
  go: {{symbol: go, in: idle, out: w}}
  MORE
  ok: {{in: [d], out: idle, emit: go_done}}
  no: {{in: [f], out: idle, emit: go_failed}}
"""


def net(use="", more="", given=GIVEN):
    return parse_net(NET.replace("USE", use).replace("MORE", more.replace("GIVEN", given)))


@pytest.mark.parametrize(
    ("use", "more", "name"),
    [
        (f"use: {{template: copy, with: {GIVEN}}}", "", "ask"),
        ("", "part: {use: leaf, in: w, out: d, on_failure: f, arguments: GIVEN}", "part.ask"),
        ("", "part: {use: branch, in: w, out: d, on_failure: f, arguments: GIVEN}", "part.leaf.ask"),
    ],
)
def test_a_value_keeps_its_type(use, more, name):
    assert net(use, more).transitions[name].action.fields == EXPECTED


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (GIVEN.replace("x: 1.50", "y: 1.50"), r"parameter at has no field 'x' \(known: names, y\)"),
        (GIVEN.replace("num: 7", "num: 7, nums: 8"), "no argument 'nums'"),
        (GIVEN.replace("flag: false", "flag: "), "nothing is not a text"),
        (GIVEN.replace("num: 7", "num: [7]"), r"'num' is \[7\], neither a whole number nor a text"),
        (GIVEN.replace("[0.1", "[.inf"), "is not a finite number"),
    ],
)
def test_a_value_that_does_not_fit_is_named(given, said):
    with pytest.raises(NetFileError, match=said):
        net("", "part: {use: leaf, in: w, out: d, on_failure: f, arguments: GIVEN}", given)
