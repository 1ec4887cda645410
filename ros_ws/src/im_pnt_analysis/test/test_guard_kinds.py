"""Guards over each kind of value: decided as the engine evaluates them, and proved with what each way needs."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_pnt.errors import NetError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import evaluate
from im_pnt.expression.syntax import parse
from im_pnt.expression.types import INTEGER, NUMBER, TEXT, ValueType, list_of, message_type
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_analysis.guards import coverage
from im_pnt_analysis.guards.coverage import decide_guards
from im_pnt_analysis.simulation.replay import FiringSequence, replay
from im_pnt_analysis.verify.proofs import fingerprint
from im_pnt_analysis.verify.report import readable

BYTE = ValueType(INTEGER.kind, lowest=0, highest=255)
TYPES = {
    "a_msgs/msg/Reading": {
        "level": BYTE,
        "value": NUMBER,
        "name": TEXT,
        "three": list_of(NUMBER, 3),
        "at": message_type("a_msgs/msg/At"),
    },
    "a_msgs/msg/At": {"x": NUMBER, "count": INTEGER},
}


class Types:
    def fields(self, message):
        return TYPES.get(message)


@pytest.fixture(autouse=True)
def types(monkeypatch):
    monkeypatch.setattr(coverage, "installed_types", Types)


def choice(*guards, arguments="", places="", before="pick: {symbol: pick, in: idle, out: chosen}"):
    ends = "".join(
        f'  end_{n}: {{in: chosen, out: idle, guard: "{guard}", emit: pick_done}}\n' for n, guard in enumerate(guards)
    )
    return parse_net(
        f"net: n\nplaces: {{idle: {{tokens: 1, resource: true}}, chosen: , trouble: , {places}}}\nescalate: trouble\n"
        f"commands: {{pick: {{arguments: {{{arguments}}}}}}}\ntransitions:\n  {before}\n"
        f"  close: {{in: trouble, out: idle, emit: pick_failed}}\n{ends}"
    )


def left_out(net):
    with pytest.raises(NetError) as refused:
        decide_guards(net)
    return refused.value.facts["values"]


NAMES = [
    *("arguments.l[0]", "arguments.l[arguments.i]", "arguments.l[arguments.i - 1]", "len(arguments.l)"),
    *("arguments.i", "len(arguments.s)", "round(arguments.i / 2)", "max(arguments.i, 1)"),
]
CONDITIONS = st.builds("{} {} {}".format, st.sampled_from(NAMES), st.sampled_from(["<", "==", ">="]), st.integers(0, 2))
CONDITIONS |= st.sampled_from(
    [
        "arguments.s == ''",
        "arguments.s in ['a', 'bb']",
        "arguments.l == [0, 1]",
        "arguments.l != []",
        "1 in arguments.l",
    ]
)
CONDITIONS |= st.builds("any(arguments.l, item {} arguments.i)".format, st.sampled_from(["<", ">=", "=="]))
GUARDS = st.recursive(
    CONDITIONS,
    lambda of: st.builds("({} {} {})".format, of, st.sampled_from(["and", "or"]), of) | of.map("(not {})".format),
    max_leaves=3,
)


@given(st.lists(st.tuples(GUARDS, st.booleans()), min_size=1, max_size=3))
def test_lists_indices_and_texts_are_decided_as_they_are_evaluated(guards):
    def passes(text, negated, values):
        try:
            return evaluate(parse(text), lambda root, name: values[name]) is not negated
        except ExpressionError:
            return negated

    lists = [list(each) for length in range(3) for each in product((0, 1), repeat=length)]
    values = [{"l": each, "i": i, "s": s} for each, i, s in product(lists, (0, 1, 2), ("", "a", "bb"))]
    missed = [each for each in values if not any(passes(*guard, each) for guard in guards)]
    net = choice(
        *(f"{'not ' * negated}${{{text}}}" for text, negated in guards),
        arguments="l: {type: integers, length: [0, 2], minimum: 0, maximum: 1}, "
        "i: {type: integer, minimum: 0, maximum: 2}, s: {type: string, choices: ['', a, bb]}",
    )
    if missed:
        assert left_out(net)
    else:
        assert len(decide_guards(net).decided) == len(guards)


READ = "pick: {symbol: pick, in: idle, out: chosen, await: {name: /r, type: a_msgs/msg/Reading UNTIL}, timeout: 1.0}"


@pytest.mark.parametrize(
    ("guards", "missed"),
    [
        (["${answers.pick.level <= 255}"], ""),
        (["${answers.pick.level < 255}"], "answers.pick.level = 255"),
        (["${answers.pick.value <= 1}", "${answers.pick.value >= 2}"], "answers.pick.value = 1.5"),
        (["${answers.pick.at.x < 1}", "${answers.pick.at.x >= 1}"], ""),
        (["${answers.pick.at.count <= 1}", "${answers.pick.at.count >= 2}"], ""),
        (["${answers.pick.three[2] < 1}", "${answers.pick.three[2] >= 1}"], ""),
        (["${len(answers.pick.name) > 0}", "${answers.pick.name == ''}"], ""),
    ],
)
def test_types_of_messages_count_where_they_are_known(guards, missed):
    net = choice(*guards, before=READ.replace(" UNTIL", ""))
    if missed:
        assert left_out(net) == missed
    else:
        assert len(decide_guards(net).decided) == len(guards)


def test_a_proof_holds_for_the_types_that_it_was_made_with(monkeypatch):
    net = choice("${answers.pick.at.x < 1}", "not ${answers.pick.at.x < 1}", before=READ.replace(" UNTIL", ""))
    before = fingerprint([net])
    assert fingerprint([net]) == before
    monkeypatch.setitem(TYPES, "a_msgs/msg/At", {"x": INTEGER})
    assert fingerprint([net]) != before


def test_what_a_message_was_waited_for_with_is_known_afterwards():
    awaited = READ.replace(" UNTIL", ", until: '${answers.pick.value > 5}'")
    assert decide_guards(choice("${answers.pick.value > 3}", before=awaited)).decided == {"end_0"}
    assert left_out(choice("${answers.pick.value > 6}", before=awaited)) == "answers.pick.value = 6"


FAILED = """pick: {symbol: pick, in: idle, out: idle, action: f, on_failure: missed, emit: pick_done}
  lost: {in: missed, out: chosen, guard: "${failure.code == 'lost'}"KEEPS}
  other: {in: missed, out: idle, guard: "not ${failure.code == 'lost'}", emit: pick_failed}"""


def test_a_failure_that_a_token_does_not_carry_on_is_not_known_afterwards():
    def net(keeps, *guards):
        return choice(*guards, before=FAILED.replace("KEEPS", keeps), places="missed: ")

    assert "failure.code = ''" in left_out(net("", "${failure.code == 'lost'}"))
    assert "end_0" in decide_guards(net(", keeps_failure: true", "${failure.code == 'lost'}")).decided
    assert "end_0" in decide_guards(net("", "${failure.code == ''}")).decided
    assert left_out(net(", keeps_failure: true", "${failure.code == ''}")).startswith("failure.code = 'lost'")


COUNTS = """pick: {symbol: pick, in: idle, out: ready}
  begin: {in: ready, out: next, store: {count: {data: 0}}}
  more: {in: next, out: chosen, guard: "${data.count.data < len(arguments.l)}"}
  end: {in: next, out: idle, guard: "not ${data.count.data < len(arguments.l)}", emit: pick_done}
  go_on: {in: turned, out: next, store: {count: {data: "${data.count.data STEP}"}}}"""


@pytest.mark.parametrize(("step", "known"), [("+ 1", True), ("- 1", False), ("* 2", False)])
def test_a_counter_stays_at_or_above_its_begin_and_below_the_limit_that_was_passed(step, known):
    net = choice(
        "${arguments.l[data.count.data] < 3}",
        "${arguments.l[data.count.data] >= 3}",
        arguments="l: {type: numbers}",
        places="ready: , turned: , next: {data_object: {name: count, type: a_msgs/msg/Count}}",
        before=COUNTS.replace("STEP", step),
    )
    if known:
        assert {"end_0", "end_1"} <= decide_guards(net).decided
    else:
        assert "data.count.data = -1" in left_out(net)


def test_a_value_that_another_token_of_the_command_may_change_is_not_known():
    fork = """pick: {symbol: pick, in: idle, out: [a, b]}
  set: {in: a, out: c, store: {o: {data: "${arguments.x}"}}}
  large: {in: c, out: chosen, guard: "${data.o.data > 3}"}
  small: {in: c, out: idle, guard: "not ${data.o.data > 3}", emit: pick_failed}
  reset: {in: b, out: d, store: {o: {data: VALUE}}}"""
    places = "a: , b: , c: , d: , told: {data_object: {name: o, type: a_msgs/msg/Count}}"
    options = {"arguments": "x: {type: number}", "places": places}
    assert "data.o.data = " in left_out(choice("${data.o.data > 3}", before=fork.replace("VALUE", "1"), **options))
    alone = fork.replace("reset: {in: b, out: d, store: {o: {data: VALUE}}}", "reset: {in: b, out: d}")
    assert "end_0" in decide_guards(choice("${data.o.data > 3}", before=alone, **options)).decided


TWO_ARMS = """pick: {symbol: pick, in: BEGIN, out: chosen}
  near: {in: [chosen, left], out: [idle, GIVEN], guard: "${arguments.x < 3}", emit: pick_done}
  far: {in: [chosen, right], out: [idle, right HELD], guard: "${arguments.x >= 3}", emit: pick_done}"""
ARMS = "left: {tokens: 1, resource: true}, right: {tokens: 1, resource: true}"


def test_a_choice_between_resources_is_no_wait_for_either():
    free = TWO_ARMS.replace("BEGIN", "idle").replace("GIVEN", "left").replace(" HELD", "")
    net = choice(before=free, places=ARMS, arguments="x: {type: number}")
    report = verify_to_load([net])
    assert report.ok
    assert not any("becomes true" in text for text in report.assumptions)


def test_a_token_that_waits_for_what_its_own_command_holds_is_stuck_though_another_way_is_free():
    held = TWO_ARMS.replace("BEGIN", "[idle, left]").replace("GIVEN", "{left: 2}").replace(" HELD", ", left")
    net = choice(
        before=held.replace("[idle, {left: 2}]", "{idle: 1, left: 2}"), places=ARMS, arguments="x: {type: number}"
    )
    report = verify_to_load([net])
    assert "near.chosen=1" in readable(report, {})
    refusal = report.refusals[0]
    last = list(replay([net], FiringSequence(refusal.sequence, marking=refusal.marking)))[-1]
    assert last.transition == "near.choose"
    inhibited = """pick: {symbol: pick, in: idle, out: chosen}
  near: {in: chosen, out: idle, inhibitors: [left], guard: "${arguments.x < 3}", emit: pick_done}
  far: {in: chosen, out: idle, guard: "${arguments.x >= 3}", emit: pick_done}"""
    net = choice(before=inhibited, places=ARMS, arguments="x: {type: number}")
    assert "near.chosen=1" in readable(verify_to_load([net]), {})


def test_a_token_that_waits_for_its_way_is_still_seen_by_inhibitors():
    seen = """pick: {symbol: pick, in: idle, out: chosen}
  near: {in: [chosen, left], out: [late, left], guard: "${arguments.x < 3}"}
  far: {in: chosen, out: idle, inhibitors: [left], guard: "not ${arguments.x < 3}", emit: pick_done}
  last: {in: [late, right], out: [idle, right], inhibitors: [chosen], emit: pick_done}"""
    report = verify_to_load([choice(before=seen, places=ARMS + ", late: ", arguments="x: {type: number}")])
    assert "far.chosen=1" in readable(report, {})


def test_a_way_that_no_value_goes_is_no_way_into_trouble():
    before = """pick: {symbol: pick, in: [idle, left], out: a}
  far: {in: a, out: [idle, left], guard: "${arguments.x >= 3}", emit: pick_done}
  near: {in: a, out: chosen, guard: "${arguments.x < 3}"}
  one: {in: [chosen, right], out: [idle, left, right], guard: "${arguments.x < 3}", emit: pick_done}
  two: {in: [chosen, left], out: [idle, {left: 2}], guard: "${arguments.x >= 3}", emit: pick_done}"""
    before = before.replace("[idle, {left: 2}]", "{idle: 1, left: 2}")
    assert verify_to_load([choice(before=before, places=ARMS + ", a: ", arguments="x: {type: number}")]).ok


def test_a_wait_of_python_for_one_resource_is_named_though_its_opposite_needs_another():
    waits = """pick: {symbol: pick, in: idle, out: chosen}
  near: {in: [chosen, left], out: [idle, left], guard: is_near, emit: pick_done}
  far: {in: [chosen, right], out: [idle, right], guard: not is_near, emit: pick_done}"""
    report = verify_to_load([choice(before=waits, places=ARMS)])
    assert report.ok
    assert any(
        "whether each of the guards 'is_near' (near), 'not is_near' (far)" in text for text in report.assumptions
    )


def test_what_is_computed_with_rounded_numbers_or_never_declared_is_said_to_be_left_out():
    rounded = choice("${arguments.x / 49 * 49 == arguments.x}", arguments="x: {type: number, minimum: 0, maximum: 5}")
    assert 1 / 49 * 49 != 1  # which hangs
    assert "not looked at whether each of the guards" in readable(verify_to_load([rounded]), {}).splitlines()[1]
    same = choice("${arguments.x / 49 < 3}", "${arguments.x / 49 >= 3}", arguments="x: {type: number}")
    assert len(decide_guards(same).decided) == 2
    fields = choice("${arguments.o.a > 3}", "${arguments.o.a <= 3}", arguments="o: {type: object}")
    assert readable(verify_to_load([fields]), {}).splitlines()[1] == (
        "  not looked at whether each command brings arguments.o.a (n): without one a guard counts as false"
    )


@pytest.mark.parametrize(
    ("guards", "arguments"),
    [
        (["${'a' in arguments.l}", "${arguments.l == ['b', 'b']}"], "l: {type: strings, choices: [a, b], length: 2}"),
        (["${arguments.l == arguments.m}", "${arguments.l != arguments.m}"],
         "l: {type: strings, choices: [a]}, m: {type: strings, choices: [a]}"),
        (["${sqrt(arguments.x) <= 2.5}"], "x: {type: number, minimum: 0, maximum: 4}"),
        (["${arguments.s == ''}", "${len(arguments.s) in [1, 2]}"], "s: {type: string, length: [0, 2]}"),
    ],
)  # fmt: skip
def test_no_value_of_these_is_left_out(guards, arguments):
    assert len(decide_guards(choice(*guards, arguments=arguments)).decided) in (len(guards), 0)
    assert verify_to_load([choice(*guards, arguments=arguments)]).ok
