"""Guards of several tokens of one command: refused where tokens are left for which no guard holds."""

import re

import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from im_pnt.errors import NetError, NetFileError
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_analysis.guards import command_markings
from im_pnt_analysis.guards.coverage import decide_guards

VALUES = range(1, 6)
JOINED = """
net: task
commands: {go: {arguments: {n: {type: integer, minimum: 1, maximum: 5}}}}
places: {idle: 1, p: , j: , k: , done: , bad: }
transitions:
  begin: {symbol: go, in: idle, out: [p, j]}
  small: {in: [p, j], out: done, guard: "${arguments.n < 3}"}
  large: {in: [p, j], out: done, guard: "${arguments.n > 3}"}
  end: {in: done, out: idle, emit: go_done}
  give_up: {in: [bad, j], out: idle, emit: go_failed}
"""
COUNTED = """
net: task
commands: {go: {arguments: {n: {type: integer, minimum: 1, maximum: 5}}}}
places: {idle: 1, p: , count: {data_object: {name: k, type: std_msgs/msg/Int64}}, done: , bad: , worse: }
transitions:
  begin: {symbol: go, in: idle, out: [p, count], store: {k: {data: 0}}, on_failure: worse}
  more:
    in: p
    out: p
    guard: ${data.k.data < arguments.n}
    store: {k: {data: "${data.k.data + 2}"}}
    on_failure: bad
  stop: {in: [p, count], out: done, guard: "${data.k.data LAST arguments.n}"}
  end: {in: done, out: idle, emit: go_done}
  give_up: {in: [bad, count], out: idle, emit: go_failed}
  fail: {in: worse, out: idle, emit: go_failed}
"""


def refusal(text):
    with pytest.raises(NetError) as refused:
        decide_guards(parse_net(text))
    return str(refused.value)


@pytest.mark.parametrize(
    "way_out",
    [
        "",
        "  cancel: {in: p, out: bad, guard: cancelled}\n",
        "  cancel: {in: [p, j], out: bad, guard: cancelled}\n  late: {in: [p, k], out: done}\n",
        "  late: {in: [j, k], out: done}\n",
        "  watch: {in: k, out: bad, await: {name: /stop, type: std_msgs/msg/Empty}, on_failure: bad}\n",
    ],
)
def test_a_way_out_for_one_of_two_tokens_hides_no_value(way_out):
    told = refusal(JOINED + way_out)
    assert "with n = 3 nothing fires" in told


def test_the_token_that_goes_on_is_no_wait_of_the_other():
    assert "with n = 1 and data.k.data = 2 nothing fires at 'p'" in refusal(COUNTED.replace("LAST", "=="))
    net = parse_net(COUNTED.replace("LAST", ">="))
    assert {"more", "stop"} <= decide_guards(net).decided
    assert verify_to_load([net]).ok


def test_a_watch_beside_a_wait_ends_no_wait():
    watched = JOINED.replace("out: [p, j]}", "out: [p, j, k]}")
    assert "with n = 3" in refusal(
        watched + "  watch: {in: k, out: k, await: {name: /stop, type: std_msgs/msg/Empty}, on_failure: bad}\n"
    )
    message = "{name: /stop, type: std_msgs/msg/Empty}, timeout: 3.0"
    timed = f"  watch: {{in: [p, k], out: done, await: {message}, on_failure: done}}\n"
    assert "small" in decide_guards(parse_net(watched + timed)).decided


def test_guards_of_messages_that_are_awaited_leave_values_out_too():
    message = "await: {name: /stop, type: std_msgs/msg/Empty}, on_failure: done"
    text = JOINED.replace("out: done, guard", f"out: done, {message}, guard")
    assert "with n = 3" in refusal(text)
    assert {"small", "large"} <= decide_guards(parse_net(text.replace("> 3", ">= 3"))).decided


def test_of_a_command_with_too_many_markings_nothing_is_said(monkeypatch):
    monkeypatch.setattr(command_markings, "MOST_MARKINGS", 2)
    net = parse_net(JOINED.replace("> 3", ">= 3"))
    assert decide_guards(net).decided == frozenset()
    assert "whether each of the guards" in " ".join(verify_to_load([net]).assumptions)


def looped(low, high, step="+ 1", first="0", limit="{type: integer, minimum: 1, maximum: 5}"):
    return f"""
net: task
commands: {{go: {{arguments: {{n: {limit}}}}}}}
places: {{idle: 1, turn: {{data_object: {{name: k, type: std_msgs/msg/Int64}}}}, bad: }}
escalate: bad
transitions:
  begin: {{symbol: go, in: idle, out: turn, store: {{k: {{data: {first}}}}}}}
  more: {{in: turn, out: turn, guard: "${{{low}}}", store: {{k: {{data: "${{data.k.data {step}}}"}}}}}}
  stop: {{in: turn, out: idle, guard: "${{{high}}}", emit: go_done}}
  give_up: {{in: bad, out: idle, emit: go_failed}}
"""


@pytest.mark.parametrize(
    "net",
    [
        looped("data.k.data < 3", "data.k.data == 3"),
        looped("data.k.data < arguments.n", "data.k.data == arguments.n"),
        looped("data.k.data > 0", "data.k.data == 0", "- 1", '"${arguments.n}"'),
        looped("data.k.data < 6", "data.k.data >= 6 and data.k.data < 9", "+ 3", "1"),
        looped("data.k.data == 0 or data.k.data == 1", "data.k.data == 2"),
    ],
)
def test_a_counter_is_known_step_by_step(net):
    assert {"more", "stop"} <= decide_guards(parse_net(net)).decided


@pytest.mark.parametrize(
    ("net", "told"),
    [
        (looped("data.k.data < 3", "data.k.data == 3", "+ 2"), "data.k.data = 4"),
        (looped("data.k.data < arguments.n", "data.k.data == arguments.n", limit="{type: integer}"), "n = "),
        (looped("data.k.data > 0", "data.k.data == 0", "- 1", '"${arguments.n - 6}"'), "n = "),
        (looped("data.k.data == 0", "data.k.data == 2"), "data.k.data = 1"),
    ],
)
def test_a_counter_that_passes_its_end_is_refused(net, told):
    assert told in refusal(net)


def test_a_counter_that_another_token_changes_meanwhile_is_not_known():
    text = (
        looped("data.k.data < 3", "data.k.data == 3")
        .replace("out: turn, store: {k: {data: 0}}", ("out: [turn, beside], store: {k: {data: 0}}"))
        .replace("bad: }", "bad: , beside: , after: }")
        .replace("in: turn, out: idle", "in: [turn, after], out: idle")
    )
    besides = '  beside: {in: beside, out: after, store: {k: {data: "${data.k.data + 1}"}}}\n'
    assert "nothing fires at 'turn'" in refusal(text.replace("in: bad, out", "in: [bad, after], out") + besides)


def test_a_number_that_is_no_step_of_the_counter_bounds_nothing():
    assert "data.k.data = -" in refusal(looped("data.k.data >= 0", "data.k.data == 100", "* 0 + -data.k.data + 1"))


PLACES = ("p", "q", "r", "s")
SOME = st.lists(st.sampled_from(PLACES), min_size=1, max_size=2, unique=True)
GUARD = st.one_of(
    st.just(""),
    st.just("cancelled"),
    st.builds("${{arguments.n {} {}}}".format, st.sampled_from(["<", ">=", "=="]), st.integers(1, 5)),
)


def hanging(steps, first, value):
    """Markings without an enabled transition though tokens lie at the inputs of some, under one value."""

    def holds(guard):
        if not guard or guard == "cancelled":
            return not guard
        sign, number = re.fullmatch(r"\$\{arguments\.n (\S+) (\d)\}", guard).groups()
        return {"<": value < int(number), ">=": value >= int(number), "==": value == int(number)}[sign]

    found, pending = {first}, [first]
    while pending and len(found) < 1000:
        marking = pending.pop()
        near = [step for step in steps if set(step[0]) <= set(marking)]
        firing = [step for step in near if holds(step[2])]
        if near and not firing:
            yield marking
        for needed, given_, _ in firing:
            left = list(marking)
            for place in needed:
                left.remove(place)
            after = tuple(sorted((*left, *given_)))
            if after not in found:
                found.add(after)
                pending.append(after)


COUNTS = st.builds(
    "${{data.k.data {} {}}}".format, st.sampled_from(["<", ">=", "=="]), st.sampled_from(["1", "2", "arguments.n"])
)
STORES = st.sampled_from(["", "0", "1", "${data.k.data + 1}", "${data.k.data - 1}", "${arguments.n}"])
FARTHEST = 6


def hanging_count(steps, first, value):
    """As hanging(), with a counter that begins with 0 and is followed as far as a limit."""

    def holds(guard, count):
        if not guard or guard == "cancelled":
            return not guard
        name, sign, other = re.fullmatch(r"\$\{(\S+) (\S+) (\S+)\}", guard).groups()
        left, right = count if name == "data.k.data" else value, value if other == "arguments.n" else int(other)
        return {"<": left < right, ">=": left >= right, "==": left == right}[sign]

    def stored(text, count):
        new = {"": count, "${data.k.data + 1}": count + 1, "${data.k.data - 1}": count - 1, "${arguments.n}": value}
        return new[text] if text in new else int(text)

    found, pending = {(first, 0)}, [(first, 0)]
    while pending and len(found) < 1000:
        marking, count = pending.pop()
        near = [step for step in steps if set(step[0]) <= set(marking)]
        firing = [step for step in near if holds(step[2], count)]
        if near and not firing:
            yield marking
        for needed, given_, _, store in firing:
            left = list(marking)
            for place in needed:
                left.remove(place)
            after = tuple(sorted((*left, *given_))), stored(store, count)
            if after not in found and abs(after[1]) < FARTHEST:
                found.add(after)
                pending.append(after)


def require_no_hang(text, first, steps, hangs):
    """No guard that is decided stands at a marking that hangs; a refused net has none to look at."""
    try:
        decided = decide_guards(parse_net(text)).decided
    except NetFileError:  # a step that no command comes to
        reject()
    except NetError:
        return
    guarded = {f"t{n}": step for n, step in enumerate(steps) if step[2]}
    for value in VALUES:
        for marking in hangs(steps, tuple(sorted(first)), value):
            stuck = {name for name, step in guarded.items() if set(step[0]) <= set(marking)}
            assert not stuck & decided, (value, marking)


@given(SOME, st.lists(st.tuples(SOME, SOME, st.one_of(GUARD, COUNTS), STORES), min_size=1, max_size=4))
def test_no_count_hangs_a_net_whose_guards_are_decided(first, steps):
    lines = "\n".join(
        f"  t{n}: {{in: [{', '.join(needed)}], out: [{', '.join(given_)}]"
        + (f", guard: '{guard}'" if guard else "")
        + (f', store: {{k: {{data: "{store}"}}}}, on_failure: bad}}' if store else "}")
        for n, (needed, given_, guard, store) in enumerate(steps)
    )
    text = (
        "net: task\ncommands: {go: {arguments: {n: {type: integer, minimum: 1, maximum: 5}}}}\n"
        "places: {idle: {tokens: 1, resource: true}, count: {data_object: {name: k, type: std_msgs/msg/Int64}}, "
        f"{': , '.join(PLACES)}: , bad: }}\n"
        f"transitions:\n  begin: {{symbol: go, in: idle, out: [idle, count, {', '.join(first)}],"
        f" store: {{k: {{data: 0}}}}, on_failure: idle}}\n{lines}\n"
    )
    require_no_hang(text, first, steps, hanging_count)


@given(SOME, st.lists(st.tuples(SOME, SOME, GUARD), min_size=1, max_size=5))
def test_no_value_hangs_a_net_whose_guards_are_decided(first, steps):
    lines = "\n".join(
        f"  t{n}: {{in: [{', '.join(needed)}], out: [{', '.join(given_)}]" + (f", guard: '{guard}'}}" if guard else "}")
        for n, (needed, given_, guard) in enumerate(steps)
    )
    text = (
        "net: task\ncommands: {go: {arguments: {n: {type: integer, minimum: 1, maximum: 5}}}}\n"
        f"places: {{idle: {{tokens: 1, resource: true}}, {': , '.join(PLACES)}: }}\n"
        f"transitions:\n  begin: {{symbol: go, in: idle, out: [idle, {', '.join(first)}]}}\n{lines}\n"
    )
    require_no_hang(text, first, steps, hanging)
