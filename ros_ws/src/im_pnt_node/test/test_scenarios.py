"""Scenarios: what comes when, what is answered, what is expected; the shipped ones, and the ones that must fail."""

import gc
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from argparse import ArgumentParser
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import ConfigError
from im_pnt.expression.types import BOOLEAN, INTEGER, NUMBER, NoTypes, installed_types, message_type
from im_pnt_node.cli import scenarios as command
from im_pnt_node.scenario import file as file_module
from im_pnt_node.scenario.draws import Draws, shrink
from im_pnt_node.scenario.file import (
    AnswerFile,
    ExpectationFile,
    ScenarioFile,
    ScenariosFile,
    StepFile,
    load_scenarios,
)
from im_pnt_node.scenario.report import Coverage
from im_pnt_node.scenario.run import ScenarioRunner
from im_pnt_node.scenario.verdict import judge, unreached

ROOT = Path(__file__).resolve().parents[4]
SHIPPED = sorted([*(ROOT / "docs/nets").rglob("*.test.yml"), *(ROOT / "ros_ws/src").glob("*/*/nets/*.test.yml")])

#: What no scenario can reach: tries for no command are never cancelled, and an action begins at once unless paused.
_RULES = ("low_battery", "person", "near")  # with mocks all ends at once: test_interrupts has the others
NEVER = {
    "errand": {"cancelled", "reach.person.give_up_again", "reach.near.end"}
    | {f"reach.{rule}.{part}" for rule in _RULES for part in ("end_stopped", "give_up")},
    "find": {"search.power.again", "guard ${false}"},
    # a part has a name, and the arms are two
    "handover": {f"{part}.again" for part in ("find.power", "giver", "receiver")}
    | {f"{step}.pass" for step in ("grasp.allow", "grasp.take", "grasp.take.touch", "grasp.part")}
    | {f"{step}.pass" for step in ("pass.allow", "pass.take", "pass.take.touch", "pass.part")}
    | {f"{step}.pass" for step in ("set_down.allow", "set_down.leave", "set_down.leave.touch", "set_down.part")}
    | {"pass.refuse", "pass.approach_first", "guard ${'left' == 'right'}", "guard ${'right' == 'right'}"}
    | {"guard ${arguments.name != ''}", "guard ${false}"},
    "maintenance": {"grease_cancelled_1", "grease_cancelled_2", "cancelled"},
    "nets/hand_over": {"giver.again", "receiver.again", "pass.take.touch.pass", "guard ${false}"},
    "pick": {"power.again", "grasp.take.touch.pass", "guard ${false}"},
    "place": {"power.again", "set_down.leave.touch.pass", "guard ${false}"},
    "palletising": {"lay_sheet_cancelled_1", "lay_sheet_cancelled_2"},
    "polishing_cell": {"change_wheel_cancelled_1", "change_wheel_cancelled_2", "cancelled"},
    "watch_dog": {"not_begun"},
}

NET = """
net: cell
places: {arm: 1, looking: , seen: , held: , failed: }
commands:
  pick: {arguments: {limit: {type: integer, minimum: 0, maximum: 9}}}
transitions:
  begin: {symbol: pick, in: arm, out: looking}
  look:
    in: looking
    out: seen
    service: {name: /look, type: std_srvs/srv/Trigger}
    delay: 2.0
    on_failure: failed
  easy: {in: seen, out: held, guard: "${arguments.limit < 3}"}
  hard: {in: seen, out: held, guard: "${arguments.limit > 3}"}
  reach:
    in: held
    out: arm
    goal: {name: /reach, type: control_msgs/action/FollowJointTrajectory, goal: {}}
    timeout: 10.0
    on_failure: failed
    on_doubt: looking
    emit: pick_done
    result: {reached: true}
  stop: {symbol: {name: stop, of: command, expires: 0}, in: looking, out: failed}
  give_up: {in: failed, out: arm, emit: pick_failed}
"""
PICK = "{symbol: pick, arguments: {limit: 1}"


def write(folder, scenario, net=NET):
    (folder / "cell.yaml").write_text(net)
    file = folder / "cell.test.yml"
    file.write_text(f"scenarios:\n  one:\n{scenario}")
    return file


def judged(folder, scenario, net=NET, seed=0):
    file = load_scenarios(write(folder, scenario, net))
    return judge(file, file.scenarios[0], Coverage(), NoTypes(), seed)


def complaints(folder, scenario, net=NET):
    return list(judged(folder, scenario, net).complaints)


# Files.


@pytest.mark.parametrize(
    ("scenario", "line", "sentence"),
    [
        ("    stepz: []", 3, "did you mean 'steps'?"),
        ("    steps: [{symbol: pik}]", 3, "there is no symbol 'pik' (did you mean 'pick'?)"),
        ("    steps: [{symbol: pick}]", 3, "argument limit is missing, a whole number from 0 to 9"),
        ("    steps: [{symbol: pick, arguments: {limit: 10}}]", 3, "argument limit is 10, not a whole number"),
        ("    steps:\n    - {symbol: stop}\n    - {symbol: stop, cancel: pick}", 5, "symbol and cancel"),
        ("    steps: [{at: 1.0}]", 3, "it is none"),
        ("    steps: [{cancel: pick, takes: 3.0}]", 3, "is of a symbol or request, not of cancel"),
        ("    steps: [{symbol: stop}]\n    answers: {lok: {}}", 4, "action 'lok' (did you mean 'look'?)"),
        ("    steps: [{symbol: stop}]\n    answers: {look: {doubt: a, failure: b}}", 4, "in one way"),
        ("    steps: [{symbol: stop}]\n    answers: {begin: {}}", 4, "no transition with an action 'begin'"),
        ("    steps: [{symbol: stop}]\n    guards: {ready: true}", 4, "no guard 'ready'"),
        ("    steps: [{symbol: stop}]\n    expect:\n      order: [look!, raech]", 5, "'raech' (did you mean 'reach'?)"),
        ("    steps: [{symbol: stop}]\n    expect: {marking: {amr: 1}}", 4, "'amr' (did you mean 'arm'?)"),
        ("    steps: [{while: easy, symbol: stop}]", 3, "no transition with an action 'easy'"),
        ("    steps: [{symbol: stop, at: -1}]", 3, "at"),
        ("    steps: [{symbol: stop, takes: [3, 1]}]", 3, "the least time, 3 s, is greater than the greatest, 1 s"),
        ("    steps: [{symbol: stop}]\n    answers: {look: {code: dark}}", 4, "is of a failure; give `failure`"),
        ("    steps: [{symbol: stop}]\n    objects: {seen: {x: 1}}", 4, "there is no data object 'seen'"),
    ],
)
def test_an_error_names_file_line_and_what_is_allowed(tmp_path, scenario, line, sentence):
    file = write(tmp_path, scenario)
    with pytest.raises(ConfigError) as error:
        load_scenarios(file)
    assert error.value.message.startswith(f"{file}:{line}: ")
    assert sentence in error.value.message


TYPED = """net: cell
commands: {go: {}}
places: {arm: 1, asked: , at: {data_object: {name: map, type: a_msgs/msg/Map}}, seen: }
transitions:
  ask: {symbol: go, in: arm, out: asked}
  look: {in: asked, out: at, service: {name: /look, type: a_msgs/srv/Look}, on_failure: arm}
  see: {in: at, out: seen, await: {name: /seen, type: a_msgs/msg/Map}, on_failure: arm}
  good: {in: seen, out: arm, guard: "${answers.look.success and answers.see.point.y == 0}", emit: go_done}
  bad: {in: seen, out: arm, guard: otherwise, emit: go_failed}
"""
FIELDS = {
    "a_msgs/srv/Look_Request": {"where": NUMBER},
    "a_msgs/srv/Look_Response": {"success": BOOLEAN, "size": INTEGER},
    "a_msgs/msg/Map": {"point": message_type("a_msgs/msg/Point")},
    "a_msgs/msg/Point": {"x": NUMBER, "y": NUMBER},
}


class TypesHere:
    def fields(self, message):
        if message not in FIELDS:
            raise ConfigError(f"there is no type {message}")
        return FIELDS[message]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            "answers: {look: {answer: {sucess: true}}}",
            "answers.look.answer.sucess: a_msgs/srv/Look_Response has no field",
        ),
        ("answers: {look: [{}, {answer: {size: big}}]}", "answers.look[1].answer.size: 'big' is not a whole number"),
        ("answers: {look: {when: {wher: 1}}}", "when.wher: a_msgs/srv/Look_Request has no field 'wher' (did you mean"),
        ("objects: {map: {point: {z: 1}}}", "objects.map.point.z: a_msgs/msg/Point has no field 'z'"),
        ("objects: {mapp: {}}", "there is no data object 'mapp' (did you mean 'map'?)"),
        ("steps: [{messages: {/seen: {point: 3}}}]", "messages./seen.point: '3' is not a_msgs/msg/Point"),
    ],
)
def test_a_field_that_the_message_does_not_have_is_refused(tmp_path, monkeypatch, lines, said):
    monkeypatch.setattr(file_module, "installed_types", TypesHere)
    with pytest.raises(ConfigError, match=re.escape(said)):
        load_scenarios(write(tmp_path, f"    {lines}", TYPED))
    monkeypatch.setattr(file_module, "installed_types", NoTypes)  # no ROS, nothing known of fields
    if "mapp" not in lines:
        load_scenarios(write(tmp_path, f"    {lines}", TYPED))


def test_an_action_that_ended_well_was_a_success_and_fields_left_out_are_empty(tmp_path, monkeypatch):
    monkeypatch.setattr(file_module, "installed_types", TypesHere)
    file = load_scenarios(
        write(
            tmp_path,
            "    steps: [{symbol: go}, {symbol: go, at: 1.0, ends: failed}]\n"
            "    answers: {see: [{answer: {point: {x: 1}}}, {answer: {point: {y: 1}}}]}",
            TYPED,
        )
    )
    assert not judge(file, file.scenarios[0], Coverage(), TypesHere()).complaints


def test_a_name_of_two_nets_asks_for_the_net(tmp_path):
    (tmp_path / "other.yaml").write_text(NET.replace("net: cell", "net: other"))
    file = write(tmp_path, f"    steps: [{PICK}}}]")
    file.write_text(f"nets: [cell.yaml, other.yaml]\n{file.read_text()}")
    with pytest.raises(ConfigError, match=r"is in the nets cell, other; write cell\.pick"):
        load_scenarios(file)


# Runs.


@pytest.mark.parametrize(
    "scenario",
    [
        f"    steps: [{PICK}, takes: 2.0, results: {{reached: true}}}}]\n    expect: {{time: 2, marking: {{arm: 1}}}}",
        f"    steps: [{PICK}, takes: 7.5}}]\n    answers: {{reach: {{after: 5.5}}}}",
        f"    steps: [{PICK}, ends: failed, reason: dark}}]\n    answers: {{look: {{failure: dark}}}}",
        f"    steps: [{PICK}, ends: failed, reason: dark}}]\n"
        "    answers: {look: {answer: {success: false, message: dark}}}",
        f"    steps: [{PICK}, takes: 4.0}}]\n    answers: {{reach: [{{doubt: it died}}, {{}}]}}\n"
        "    expect: {order: [reach+, 'reach?', look, reach]}",
        f"    steps: [{PICK}, ends: failed, takes: 12.0}}]\n    answers: {{reach: {{after: 60.0}}}}",  # its time-out
        f"    steps: [{PICK}, takes: [14.0, 20.0]}}]\n    answers: {{reach: [{{silent: true}}, {{}}]}}\n"
        "    expect: {order: ['reach?', look, reach]}",
        f"    steps: [{PICK}, ends: cancelled, takes: 3.0}}, {{while: reach, at: 1.0, cancel: pick}}]\n"
        "    answers: {reach: {after: 5.0}}\n    expect: {order: ['reach~', 'reach!']}",
        f"    steps: [{PICK}, ends: failed, takes: 2.0}}, {{while: look, at: 1.0, symbol: stop}}]\n"
        "    answers: {look: {failure: dark}}",
        f"    steps: [{PICK}, ends: done}}, {{at: 1.0, symbol: pick, arguments: {{limit: 5}}, ends: failed}}]\n"
        "    answers: {reach: [{when: {limit: 5}, failure: too hard}, {}]}",
        "    steps: [{symbol: pick, arguments: {limit: 3}, ends: open}, "
        "{at: 3.0, symbol: pick, arguments: {limit: 1}, ends: waiting}]\n    until: 5.0",
    ],
)
def test_what_happens_as_expected_passes(tmp_path, scenario):
    assert complaints(tmp_path, scenario) == []


@pytest.mark.parametrize(
    ("scenario", "told"),
    [
        (f"    steps: [{PICK}, takes: 3.0}}]", "step 1, pick: it took 2 s, not 3 s"),
        (f"    steps: [{PICK}, takes: [3.0, 4]}}]", "step 1, pick: it took 2 s, not 3 to 4 s"),
        (f"    steps: [{PICK}, ends: failed}}]", "step 1, pick: it is done, not failed"),
        (f"    steps: [{PICK}, results: {{reached: 1.5}}}}]", "step 1, pick: results.reached is True, not 1.5"),
        (f"    steps: [{PICK}, results: {{seen: 1}}}}]", "step 1, pick: results: there is no seen"),
        (f"    steps: [{PICK}}}]\n    answers: {{look: {{failure: dark}}}}", "pick: it is failed (dark), not done"),
        (f"    steps: [{PICK}}}]\n    expect: {{order: [reach, look]}}", "look did not come after reach (firing 6)"),
        (f"    steps: [{PICK}}}]\n    expect: {{never: [look+]}}", "expect.never: look+ came"),
        (f"    steps: [{PICK}}}]\n    expect: {{marking: {{held: 2}}}}", "expect.marking: held holds 0, not 2"),
        (f"    steps: [{PICK}}}]\n    expect: {{time: 1}}", "expect.time: it ended at 2 s, not 1 s"),
        (f"    steps: [{PICK}}}, {{while: give_up, cancel: pick}}]", "no transition with an action"),
        ("    steps: [{symbol: pick, arguments: {limit: 3}}]", "place seen holds 1 token and is no place of rest"),
    ],
)
def test_what_does_not_is_told_with_both_sides(tmp_path, scenario, told):
    try:
        found = complaints(tmp_path, scenario)
    except ConfigError as error:
        found = [error.message]
    assert any(told in each for each in found), found


def test_a_net_without_end_is_told(tmp_path):
    net = "net: cell\nplaces: {a: 1, b: }\ntransitions: {go: {symbol: go, in: a, out: b}, on: {in: b, out: b}}"
    assert complaints(tmp_path, "    steps: [{symbol: go}]", net) == ["it does not end: 20000 firings in 0 s"]


def test_a_clock_needs_no_step(tmp_path):
    net = "net: cell\nplaces: {a: 1, b: }\nrest: [a, b]\ntransitions: {tick: {in: a, out: b, delay: 3.0}}"
    assert complaints(tmp_path, "    until: 5.0\n    expect: {order: [tick], time: 5, marking: {b: 1}}", net) == []


def test_guards_and_objects_are_mocked_and_change(tmp_path):
    net = """
net: cell
places: {a: 1, b: , spot: {data_object: {name: spot, type: std_msgs/msg/Float64, scope: global}}}
rest: [a, spot]
transitions:
  go: {symbol: go, in: a, out: b, guard: ready}
  read:
    {in: b, out: a, on_failure: a, guard: "${data.spot.data > 2}", emit: go_done, result: {was: "${data.spot.data}"}}
"""
    steps = "    steps: [{symbol: go, takes: 3.0, results: {was: 5}}, {at: 3.0, guards: {ready: true}}]\n"
    assert complaints(tmp_path, f"{steps}    objects: {{spot: {{data: 5}}}}", net) == []
    later = steps.replace("]", ", {at: 4.0, objects: {spot: {data: 5}}}]").replace("takes: 3.0", "takes: 4.0")
    assert complaints(tmp_path, f"{later}    objects: {{spot: {{data: 1}}}}", net) == []


def test_each_of_two_commands_has_stored_objects_of_its_own(tmp_path):
    net = """
net: cell
commands: {go: {arguments: {n: {type: integer}}}}
places: {a: 2, turn: {data_object: {name: k, type: std_msgs/msg/Int64}}, bad: }
escalate: bad
transitions:
  begin: {symbol: go, in: a, out: turn, store: {k: {data: 0}}}
  more: {in: turn, out: turn, guard: "${data.k.data < arguments.n}", store: {k: {data: "${data.k.data + 1}"}}}
  stop: {in: turn, out: a, guard: "${data.k.data == arguments.n}", emit: go_done, result: {was: "${data.k.data}"}}
  give_up: {in: bad, out: a, emit: go_failed}
"""
    both = ", ".join(f"{{symbol: go, arguments: {{n: {n}}}, results: {{was: {n}}}}}" for n in (3, 5))
    assert complaints(tmp_path, f"    steps: [{both}]", net) == []


# Drawn answers.


def test_the_value_at_which_a_command_hangs_is_found_and_the_rest_is_plain(tmp_path):
    verdict = judged(tmp_path, "    steps: [{symbol: pick}]\n    random: 100")
    assert verdict.complaints[0] == "step 1, pick: it has not ended"
    assert verdict.outcome.orders[1].arguments == {"limit": 3}
    assert [text for _, _, text in verdict.outcome.firings] == ["begin", "look+", "look"]


@pytest.mark.parametrize(
    ("low", "high", "found"), [("x < 0.7", "x > 0.7", 0.7), ("x < -2", "x > -2", -2), ("x <= 6", "x > 7", 7)]
)
def test_the_gap_between_two_guards_is_found_wherever_it_is(tmp_path, low, high, found):
    net = f"""
net: cell
places: {{a: 1, b: }}
commands: {{go: {{arguments: {{x: {{type: number}}}}}}}}
transitions:
  go: {{symbol: go, in: a, out: b}}
  low: {{in: b, out: a, guard: "${{{low.replace("x", "arguments.x")}}}", emit: go_done}}
  high: {{in: b, out: a, guard: "${{{high.replace("x", "arguments.x")}}}", emit: go_done}}
"""
    verdict = judged(tmp_path, "    steps: [{symbol: go}]\n    random: 100", net)
    assert verdict.outcome.orders[1].arguments == {"x": found}


def test_what_was_drawn_is_told_as_a_scenario_that_fails_alike(tmp_path):
    verdict = judged(tmp_path, "    steps: [{symbol: pick}]\n    random: 100\n    expect: {never: [give_up]}")
    told = verdict.told("here:2").splitlines()
    begin = next(rank for rank, line in enumerate(told) if "as a scenario" in line) + 1
    end = told.index("fired:")
    drawn = yaml.safe_load("\n".join(told[begin:end]))
    again = write(tmp_path, "")
    again.write_text(yaml.safe_dump({"scenarios": {"one": {**drawn, "expect": {"never": ["give_up"]}}}}))
    file = load_scenarios(again)
    repeated = judge(file, file.scenarios[0], Coverage(), NoTypes())
    assert "expect.never: give_up came" in repeated.complaints
    assert repeated.outcome.firings == verdict.outcome.firings


def test_without_ros_guards_tell_what_fields_are(tmp_path):
    net = """
net: cell
places: {a: 1, b: , c: }
transitions:
  ask: {symbol: go, in: a, out: b, service: {name: /ask, type: nowhere_msgs/srv/Ask}, on_failure: c}
  good:
    in: b
    out: a
    guard: >-
      ${(answers.ask.found or not answers.ask.parts.late) and answers.ask.count + 1 > 2
      and answers.ask.who == 'me'}
    emit: go_done
  bad: {in: b, out: c, guard: otherwise}
  end: {in: c, out: a, emit: go_failed}
"""
    write(tmp_path, "    steps: [{symbol: go}]\n    random: 200", net)
    scenarios, coverage = load_scenarios(tmp_path / "cell.test.yml"), Coverage()
    verdict = judge(scenarios, scenarios.scenarios[0], coverage, NoTypes())
    assert (verdict.complaints, verdict.outcome.troubles) == ((), [])
    assert unreached(scenarios, coverage)[2] == []


def test_the_same_seed_draws_the_same(tmp_path):
    scenario = "    steps: [{symbol: pick}]\n    random: 3"
    net = NET.replace("limit < 3", "limit <= 3")
    runs = [judged(tmp_path, scenario, net, seed).outcome.script for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


@given(st.lists(st.integers(0, 20), max_size=30), st.integers(1, 20))
def test_the_shortest_failure_has_what_fails_and_nothing_else(taken, least):
    def fails(given):
        return list(given) if any(number >= least for number in given) else None

    if fails(taken) is None:
        return
    found = shrink(taken, fails)
    assert fails(found) is not None
    assert len([number for number in found if number]) == 1


def test_draws_end_in_the_plainest():
    draws = Draws([3, 9])
    assert [draws.pick(5), draws.pick(2), draws.pick(7)] == [3, 1, 0]
    assert draws.taken == [3, 1, 0]


# The command, and pytest.


def run(*words):
    parser = ArgumentParser()
    command.add(parser.add_subparsers())
    options = parser.parse_args(["test", *map(str, words)])
    return options.run(options)


BOTH = f"    steps: [{PICK}}}]\n  two:\n    steps: [{PICK}, takes: 9.0}}]"


def test_the_command_tells_what_failed_and_what_was_not_reached(tmp_path, capsys):
    file = write(tmp_path, BOTH)
    assert run(tmp_path / "cell.yaml", "--junit", tmp_path / "out.xml") == command.FAILED
    out = capsys.readouterr().out
    assert f"FAILED  {file}:4: two" in out
    assert "1 passed, 1 failed" in out
    assert f"{tmp_path}/cell.yaml:15: hard never fired" in out
    assert f"{tmp_path}/cell.yaml:14: guard ${{arguments.limit < 3}} was never false" in out
    cases = ElementTree.parse(tmp_path / "out.xml").getroot().findall("testsuite/testcase")
    assert [(case.get("name"), case.find("failure") is not None) for case in cases] == [("one", False), ("two", True)]
    assert cases[1].find("failure").get("message") == "step 1, pick: it took 2 s, not 9 s"
    assert run(tmp_path, "--only", "one") == command.PASSED
    assert "1 passed, 0 failed" in capsys.readouterr().out


def test_the_command_refuses_what_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match=r"there is no \*\.test\.yml in it"):
        run(tmp_path)
    with pytest.raises(ConfigError, match=r"there is no nets\.test\.yml beside it"):
        run(tmp_path / "nets.yaml")
    write(tmp_path, BOTH)
    with pytest.raises(ConfigError, match="there is no scenario 'three'; there are one, two"):
        run(tmp_path, "--only", "three")


def test_pytest_collects_scenarios(tmp_path):
    write(tmp_path, BOTH)
    plugin = ["-p", "im_pnt_node.scenario.pytest_plugin"]
    words = [sys.executable, "-m", "pytest", "-p", "no:im_pnt_scenarios", *plugin, "-p", "no:cacheprovider", tmp_path]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=300)
    assert "1 failed, 1 passed" in done.stdout
    assert f"{tmp_path}/cell.test.yml:4: step 1, pick: it took 2 s, not 9 s" in done.stdout
    assert "Traceback" not in done.stdout
    (tmp_path / "cell.test.yml").write_text("scenarios: {one: {steps: [{symbol: pik}]}}")
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=300)
    assert "cell.test.yml:1: scenarios.one.steps[0].symbol: there is no symbol 'pik'" in done.stdout


# The page.

PAGE = (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")


def test_what_the_page_shows_is_what_is_printed(tmp_path, capsys, monkeypatch):
    for name, text in re.findall(r"^`(pick\.[a-z.]+)`\n```yaml\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE):
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    words, shown = re.search(r"```console\n\$ scripts/im pnt test (.*?)\n(.*?)```", PAGE, re.DOTALL).groups()
    assert run(words) == command.FAILED
    assert capsys.readouterr().out == shown
    excerpt = re.search(r"```yaml\n(  said_yes_twice:.*?)```", PAGE, re.DOTALL)[1]
    assert excerpt in (ROOT / "docs/nets/tasks/confirm.test.yml").read_text(encoding="utf-8")


def test_the_page_explains_every_key():
    rows = [line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| `")]
    explained = set(re.findall(r"`(\w+)`", "\n".join(rows)))
    models = (ScenariosFile, ScenarioFile, StepFile, AnswerFile, ExpectationFile)
    keys = {field.alias or name for model in models for name, field in model.model_fields.items()}
    assert keys - {"arguments"} == explained


# What is shipped.


def test_every_net_of_the_machine_and_every_task_has_scenarios():
    nets = [*(ROOT / "docs/nets/tasks").glob("*.yaml"), *(ROOT / "ros_ws/src").glob("*/*/nets/*.yaml")]
    named = {net.source for file in SHIPPED for net in load_scenarios(file).nets}
    assert {str(net) for net in nets} <= {str(Path(name).resolve()) for name in named}


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.name.removesuffix(".test.yml"))
def test_shipped_scenarios_pass_and_reach_everything(file):
    scenarios, coverage, types = load_scenarios(file), Coverage(), installed_types()
    for scenario in scenarios.scenarios:
        verdict = judge(scenarios, scenario, coverage, types)
        assert not verdict.complaints, verdict.told(f"{file}:{scenario.line}")
    name = file.name.removesuffix(".test.yml")
    never = NEVER.get(f"{file.parent.name}/{name}", NEVER.get(name, set()))
    left = unreached(scenarios, coverage)[2]
    assert [text for text in left if not any(f"{name} " in text for name in never)] == []
    assert all(any(f"{name} " in text for text in left) for name in never), "it is reached: NEVER says too much"


def test_a_condition_without_a_value_ends_the_action_and_is_told(tmp_path):
    (tmp_path / "n.yaml").write_text(
        "net: n\nplaces: {idle: 1, wanted: , there: , failed: }\ninterrupts:\n  full:\n    during: reach\n"
        "    watch: {name: /tank, type: std_msgs/msg/Float64}\n    if: ${1 / message.data > 2}\n    then: restart\n"
        "transitions:\n  begin: {symbol: go, in: idle, out: wanted}\n"
        "  reach: {in: wanted, out: there, goal: {name: /r, type: a/action/R}, on_failure: failed, delay: 9.0}\n"
        "  done: {in: there, out: idle, emit: go_done}\n  give_up: {in: failed, out: idle, emit: go_failed}\n"
    )
    (tmp_path / "n.test.yml").write_text(
        "scenarios:\n  s:\n    steps:\n"
        "    - {symbol: go, ends: failed, reason: for full cannot be told, takes: 5.0}\n"
        "    - {at: 2.0, messages: {/tank: {data: 4.0}}}\n    - {at: 5.0, messages: {/tank: {data: 0.0}}}\n"
        "    expect: {order: [reach.full.stop_blind, 'reach!', reach.full.fail_blind], never: [reach.full.stop]}\n"
    )
    scenarios = load_scenarios(tmp_path / "n.test.yml")
    verdict = judge(scenarios, scenarios.scenarios[0], Coverage(), installed_types())
    assert not verdict.complaints, verdict.told("")


DIAGNOSED = """
net: diagnosed
places: {idle: {tokens: 1, resource: true}, wanted: , there: , failed: }
interrupts:
  fault:
    during: reach
    watch: {name: /diagnostics, type: diagnostic_msgs/msg/DiagnosticArray}
    if: "${any(message.status, item.level >= 2 and item.name in ['motor: left', 'motor: right'])}"
    then: fail
transitions:
  begin: {symbol: go, in: idle, out: wanted}
  reach:
    in: wanted
    out: there
    on_failure: failed
    goal: {name: /drive, type: control_msgs/action/GripperCommand}
    delay: 10.0
  done: {in: there, out: idle, emit: go_done}
  undone: {in: failed, out: idle, emit: go_failed}
"""
DIAGNOSES = """
scenarios:
  faults_of_others:
    steps:
      - {symbol: go, takes: 10.0}
      - {at: 1.0, messages: {/diagnostics: {status: []}}}
      - {at: 2.0, messages: {/diagnostics: {status: [{level: 2, name: "lamp"}, {level: 1, name: "motor: left"}]}}}
  a_fault_of_one:
    steps:
      - {symbol: go, ends: failed, reason: interrupted by, takes: 3.0}
      - {at: 3.0, messages: {/diagnostics: {status: [{level: 0, name: "lamp"}, {level: 2, name: "motor: right"}]}}}
"""


def test_any_of_several_diagnostics_interrupts(tmp_path, capsys):
    (tmp_path / "diagnosed.yaml").write_text(DIAGNOSED)
    (tmp_path / "diagnosed.test.yml").write_text(DIAGNOSES)
    assert run(tmp_path / "diagnosed.yaml") == command.PASSED, capsys.readouterr().out


def test_a_garbage_collection_at_any_moment_changes_nothing(monkeypatch):
    """An action without an answer waits in a cycle of objects: broken early, it would end as a failure of its own."""
    pump = ScenarioRunner._pump

    def collecting(self, executors):
        pump(self, executors)
        gc.collect()

    monkeypatch.setattr(ScenarioRunner, "_pump", collecting)
    scenarios = load_scenarios(ROOT / "docs/nets/tasks/confirm.test.yml")
    scenario = next(each for each in scenarios.scenarios if each.name == "the_press_is_silent")
    verdict = judge(scenarios, scenario, Coverage(), installed_types())
    assert not verdict.complaints, verdict.told("confirm.test.yml")
