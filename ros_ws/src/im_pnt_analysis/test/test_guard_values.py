"""Guards over values: refused exactly where some value of what stays the same passes none."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_pnt.errors import NetError, NetFileError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import evaluate
from im_pnt.expression.syntax import parse
from im_pnt.netfile import parse_net, yaml_text
from im_pnt_analysis import verify_to_load
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.guards.coverage import GuardCoverage, decide_guards
from im_pnt_analysis.verify.report import readable

ANY_NUMBER = "{x: {type: number}}"


def net_with(*guards, arguments=ANY_NUMBER, before="", places=""):
    """A net whose command waits at ``chosen`` for guarded transitions alone."""
    ends = "\n".join(
        f'  end_{n}: {{in: chosen, out: idle, guard: "{guard}", emit: pick_done}}' for n, guard in enumerate(guards)
    )
    first = before or "  pick: {symbol: pick, in: idle, out: chosen}"
    return parse_net(
        f"net: task\nplaces: {{idle: 1, chosen: , {places}}}\ncommands: {{pick: {{arguments: {arguments}}}}}\n"
        f"transitions:\n{first}\n{ends}\n"
    )


def refusal(*guards, **others):
    with pytest.raises(NetError) as refused:
        decide_guards(net_with(*guards, **others))
    return str(refused.value)


def test_a_value_that_passes_no_guard_is_named_with_place_and_lines():
    assert refusal("${arguments.x < 3}", "${arguments.x > 3}") == (
        "net task: with x = 3 nothing fires at 'chosen' (net:6, :7); cover this case, or give a transition the guard "
        "'otherwise'"
    )
    with pytest.raises(NetError, match="with x = 3 nothing fires at 'chosen'"):
        verify_to_load([net_with("${arguments.x < 3}", "${arguments.x > 3}")])


@pytest.mark.parametrize(
    ("guards", "arguments"),
    [
        (["${arguments.x < 3}", "${arguments.x >= 3}"], ANY_NUMBER),
        (["${arguments.x < 3}", "not ${arguments.x < 3}"], ANY_NUMBER),
        (["${arguments.x < 3}", "otherwise"], ANY_NUMBER),
        (["${arguments.x < 3}", "${arguments.x > 2}"], "{x: {type: integer}}"),
        (["${arguments.x < 3}", "${arguments.x == 3}"], "{x: {type: number, maximum: 3}}"),
        (["${arguments.x == 'a'}", "${arguments.x in ['b', 'c']}"], "{x: {type: string, choices: [a, b, c]}}"),
        (["${1 / arguments.x > 0}", "not ${1 / arguments.x > 0}"], ANY_NUMBER),
        (["${arguments.x mod 2 == 0}", "${arguments.x mod 2 == 1}"], "{x: {type: integer}}"),
        (["${abs(arguments.x) <= 1}", "${arguments.x > 1 or arguments.x < -1}"], ANY_NUMBER),
        (["${len(arguments.x) > 1}", "${len(arguments.x) == 1}"], "{x: {type: numbers, length: [1, 9]}}"),
        (["${arguments.x}", "${not arguments.x}"], "{x: {type: boolean}}"),
        (["${command.symbol == 'pick'}", "${arguments.x < 3}"], ANY_NUMBER),
        (["${max(arguments.x, 0) == 0}", "${min(arguments.x, 5) > 0}"], ANY_NUMBER),
    ],
)
def test_guards_that_leave_no_value_out_are_decided(guards, arguments):
    net = net_with(*guards, arguments=arguments)
    assert decide_guards(net).decided == {"end_0", "end_1"}
    report = verify_to_load([net])
    assert report.ok
    assert not [text for text in report.assumptions if "becomes true" in text]


@pytest.mark.parametrize(
    ("guards", "arguments", "values"),
    [
        (["${arguments.x == 'a'}", "${arguments.x == 'b'}"], "{x: {type: string}}", "x = another text"),
        (["${arguments.x == 'a'}"], "{x: {type: string, choices: [a, b]}}", "x = 'b'"),
        (["${1 / arguments.x > 0}", "${1 / arguments.x <= 0}"], ANY_NUMBER, "x = 0"),
        (["${arguments.x[0] > 0}", "${arguments.x[0] <= 0}"], "{x: {type: numbers}}", "len(arguments.x) = 0"),
        (["${arguments.x and arguments.y}", "${not arguments.x}"],
         "{x: {type: boolean}, y: {type: boolean}}", "x = true and y = false"),
        (["cancelled", "${arguments.x < 3}"], "{x: {type: integer, minimum: 2, maximum: 3}}", "x = 3"),
    ],
)  # fmt: skip
def test_what_is_left_out_is_named(guards, arguments, values):
    assert f"with {values} nothing fires" in refusal(*guards, arguments=arguments)


ASKS = """
  pick: {symbol: pick, in: idle, out: chosen, service: {name: /measure, type: a_msgs/srv/Measure}, on_failure: FAILED}
"""


def test_an_answer_that_may_be_missing_is_a_value_too():
    guards = ["${answers.pick.size < 3}", "${answers.pick.size >= 3}"]
    assert decide_guards(net_with(*guards, before=ASKS.replace("FAILED", "idle"))).decided
    assert "with no answer of pick nothing fires" in refusal(*guards, before=ASKS.replace("FAILED", "chosen"))
    codes = ["${failure.code == 'lost'}", "${failure.code == ''}"]
    assert "with failure.code = another text nothing" in refusal(*codes, before=ASKS.replace("FAILED", "chosen"))


def test_a_number_of_unknown_type_is_refused_only_where_whole_numbers_are_left_out():
    def asked(*guards):
        return net_with(*guards, before=ASKS.replace("FAILED", "idle"))

    with pytest.raises(NetError, match=r"answers\.pick\.size = 3"):
        decide_guards(asked("${answers.pick.size < 3}", "${answers.pick.size > 3}"))
    assert decide_guards(asked("${answers.pick.size <= 2}", "${answers.pick.size >= 3}")).decided == frozenset()


def test_guards_passed_on_the_way_count():
    first = """
  pick: {symbol: pick, in: idle, out: seen}
  small: {in: seen, out: chosen, guard: "${arguments.x < 3}"}
  large: {in: seen, out: idle, guard: "not ${arguments.x < 3}", emit: pick_done}
"""
    others = {"before": first, "places": "seen: "}
    assert (
        len(decide_guards(net_with("${arguments.x < 1}", "${arguments.x >= 1 and arguments.x < 5}", **others)).decided)
        == 4
    )
    values = refusal("${arguments.x < 1}", "${arguments.x > 2}", **others)
    assert "nothing fires at 'chosen'" in values


def test_what_may_change_is_waited_for_and_assumed():
    place = "level: {data_object: {name: level, type: std_msgs/msg/Float64}}"
    wait = ["${data.level.data > 3}", "${data.level.data < 3}"]
    net = net_with(*wait, places=place)
    assert decide_guards(net).decided == frozenset()
    said = readable(verify_to_load([net]), {}).splitlines()[1]
    assert said.startswith("  not looked at whether each of the guards '${data.level.data > 3}' (end_0), ")
    assert said.endswith(" becomes true (task): nothing else takes the tokens meanwhile")
    beside = net_with("${arguments.x < 1}", "not ${arguments.x < 1}", "cancelled", arguments=ANY_NUMBER)
    assert "becomes true" not in readable(verify_to_load([beside]), {}, everything=True)
    mixed = net_with("${data.level.data > 3 and arguments.x > 0}", "${arguments.x < 0}", places=place)
    with pytest.raises(NetError, match="with x = 0 nothing fires"):
        decide_guards(mixed)
    stores = '  pick: {symbol: pick, in: idle, out: chosen, store: {level: {data: "${arguments.x}"}}, on_failure: idle}'
    with pytest.raises(NetError, match=r"with data\.level\.data = 3 nothing fires"):
        decide_guards(net_with(*wait, places=place, before=stores))


def test_a_token_that_leaves_with_its_object_may_wait_for_that():
    first = "  pick: {symbol: pick, in: idle, out: seen}\n  never: {in: chosen, out: idle}"
    places = "seen: {data_object: map, on_invalid: [chosen]}"
    guarded = "  go: {in: seen, out: idle, guard: '${arguments.x < 3}', emit: pick_done}"
    net = net_with(before=f"{first}\n{guarded}", places=places)
    assert decide_guards(net).decided == frozenset()


def test_the_guards_of_a_net_are_decided_once(monkeypatch):
    checked, check = [], GuardCoverage.check
    monkeypatch.setattr(GuardCoverage, "check", lambda coverage: checked.append(check(coverage)))
    net, same = (net_with("${arguments.x < 3}", "otherwise") for _ in range(2))
    for each in (net, net, same):
        compose([each])
    assert len(checked) == 2
    for _ in range(2):
        assert "with x = 4" in refusal("${arguments.x < 3}", "${arguments.x < 4}")


def test_a_function_of_python_may_say_anything_and_its_negation_the_opposite():
    assert decide_guards(net_with("is_ready", "not is_ready")).decided == {"end_0", "end_1"}
    assert decide_guards(net_with("is_ready", "${arguments.x < 3}")).decided == frozenset()
    assert decide_guards(net_with("is_ready", "otherwise")).decided == {"end_0", "end_1"}


def test_otherwise_against_a_function_of_python_says_nothing_of_later_places():
    first = """  pick: {symbol: pick, in: idle, out: seen}
  ready: {in: seen, out: idle, guard: is_ready, emit: pick_done}
  small: {in: seen, out: idle, guard: '${arguments.x < 3}', emit: pick_done}
  wait: {in: seen, out: chosen, guard: otherwise}"""
    assert "end_0" not in decide_guards(net_with("not is_ready", before=first, places="seen: ")).decided
    small = first.replace("is_ready", "'${arguments.x > 5}'")
    assert "end_0" in decide_guards(net_with("${arguments.x >= 3}", before=small, places="seen: ")).decided


def test_otherwise_needs_guards_to_stand_against():
    net = net_with("${arguments.x < 3}", "otherwise")
    assert yaml_text(parse_net(yaml_text(net))) == yaml_text(net)
    for guards in (["otherwise"], ["otherwise", "otherwise", "is_ready"]):
        with pytest.raises(NetFileError, match="'otherwise' needs other guards at the same places"):
            net_with(*guards)


NUMBERS = st.integers(-1, 4).map(str)
COMPARED = st.builds("arguments.x {} {}".format, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), NUMBERS)
COMPARED |= st.builds("arguments.x in [{}, {}]".format, NUMBERS, NUMBERS)
COMPARED |= st.builds("{} / arguments.x > {}".format, NUMBERS, NUMBERS)
COMPARED |= st.builds("arguments.x mod 3 == {}".format, NUMBERS)
CONDITIONS = st.recursive(
    COMPARED,
    lambda of: (
        st.builds("({} and {})".format, of, of) | st.builds("({} or {})".format, of, of) | of.map("(not {})".format)
    ),
    max_leaves=4,
)


@given(st.lists(st.tuples(CONDITIONS, st.booleans()), min_size=1, max_size=3))
def test_the_decision_is_that_of_trying_all_values(conditions):
    def passes(text, negated, value):
        try:
            answer = evaluate(parse(text), lambda root, name: value)
        except ExpressionError:
            answer = False
        return answer is not negated

    left_out = [x for x in range(-2, 6) if not any(passes(*each, x) for each in conditions)]
    net = net_with(
        *(f"{'not ' * negated}${{{text}}}" for text, negated in conditions),
        arguments="{x: {type: integer, minimum: -2, maximum: 5}}",
    )
    if not left_out:
        assert decide_guards(net).decided == set(net.transitions) - {"pick"}
        return
    with pytest.raises(NetError) as refused:
        decide_guards(net)
    assert int(refused.value.facts["values"].removeprefix("x = ")) in left_out
