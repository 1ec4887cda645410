"""Interrupts: what a condition does to an action while this runs, after the execution rules of Petri Net Plans."""

import pytest

from im_core.errors import ImError
from im_pnt.errors import NetFileError
from im_pnt.execution.events import Answer, CommandCancelled, Outcome
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import ActivityState
from im_pnt.model.expand import expand
from im_pnt.netfile import load_net, parse_net, yaml_text
from support.process import Clock, Process, hold

NET = """
net: n
places: {idle: 2, wanted: , there: , failed: }
commands: {go: {arguments: {limit: {type: integer, default: 5}}}}
interrupts:
  alarm: {during: reach, if: alarmed, do: [{action: say}], then: THEN, says: an alarm}
transitions:
  begin: {symbol: go, in: idle, out: wanted}
  reach: {in: wanted, out: there, action: reach, on_failure: failed}
  done: {in: there, out: idle, emit: go_done}
  give_up: {in: failed, out: idle, emit: go_failed}
"""


def process(then: str) -> tuple[Process, list[bool], Executor]:
    """Runs the net; what the guard says is open for writing."""
    alarmed = [False]
    made = Process(
        [parse_net(NET.replace("THEN", then))],
        {"reach": hold, "say": hold},
        {"alarmed": lambda ctx: alarmed[0]},
    )
    return made, alarmed, made.exchange.nets["n"]


def strike(made: Process, alarmed: list[bool]) -> None:
    """Has the condition hold once, for whoever waits for it."""
    alarmed[0] = True
    made.exchange.nets["n"].guards_changed()
    made.pump()
    alarmed[0] = False


def cancelled(made: Process) -> None:
    """Ends the drive as one that was asked to end."""
    made.end("reach", ImError("the drive was cancelled", code="cancelled"))


@pytest.mark.parametrize("then", ["restart", "skip", "fail"])
def test_the_action_is_asked_to_end_then_something_is_done_and_then_it_goes_on_as_said(then):
    made, alarmed, executor = process(then)
    made.command("n", "go")
    strike(made, alarmed)
    (activity,) = executor.activities
    assert (activity.state, activity.cancelled) == (ActivityState.CANCELLING, True)
    assert made.marking("n")["reach.cancelling"] == 1
    assert [held[1].transition for held in made.held] == ["reach"], "nothing is done before the action has ended"
    cancelled(made)
    assert [held[1].transition for held in made.held] == ["reach.alarm.do_1"]
    made.end("reach.alarm.do_1")
    if then == "restart":
        assert made.marking("n") == {"idle": 1, "reach.active": 1, "reach.alarm.armed": 1}
        made.end("reach")
    (result,) = made.results
    assert str(result.error) == ("interrupted by an alarm" if then == "fail" else "None")
    assert made.marking("n") == {"idle": 2}


def test_what_is_done_beside_the_action_is_done_once_and_the_action_is_left_alone():
    made, alarmed, executor = process("continue")
    made.command("n", "go")
    strike(made, alarmed)
    assert sorted(held[1].transition for held in made.held) == ["reach", "reach.alarm.do_1"]
    made.end("reach")
    assert not made.results, "what was begun beside it ends first"
    made.end("reach.alarm.do_1", ImError("no voice"))
    assert [result.error for result in made.results] == [None]
    assert not executor.activities


def test_only_the_action_of_the_same_command_ends():
    alarms: set[int] = set()
    made = Process(
        [parse_net(NET.replace("THEN", "skip"))],
        {"reach": hold, "say": hold},
        {"alarmed": lambda ctx: ctx.command.id in alarms},
    )
    executor = made.exchange.nets["n"]
    made.command("n", "go")
    alarms.add(made.command("n", "go") + 1)
    executor.guards_changed()
    made.pump()
    assert not any(activity.cancelled for activity in executor.activities), "the third one is not there"
    alarms.add(2)
    executor.guards_changed()
    made.pump()
    states = {activity.lineage.job.number: activity.state.value for activity in executor.activities}
    assert states == {1: "active", 2: "cancelling"}


def test_an_action_that_ends_well_all_the_same_has_ended_well():
    made, alarmed, _ = process("fail")
    made.command("n", "go")
    strike(made, alarmed)
    made.end("reach")
    assert [result.error for result in made.results] == [None]
    assert made.marking("n") == {"idle": 2}


@pytest.mark.parametrize(("then", "code"), [("restart", "way"), ("continue", "way"), ("fail", "interrupted")])
def test_a_failure_keeps_its_code_for_who_judges_it(then, code):
    """As scopes do that begin again after some failures."""
    text = NET.replace("THEN", then).replace("do: [{action: say}], ", "" if then == "fail" else "do: [{action: say}], ")
    judged = text.replace("in: failed, out: idle", "in: failed, guard: \"${failure.code == 'CODE'}\", out: idle")
    alarmed = [False]
    made = Process(
        [parse_net(judged.replace("CODE", code))],
        {"reach": hold, "say": hold},
        {"alarmed": lambda ctx: alarmed[0]},
    )
    made.command("n", "go")
    if then == "fail":
        strike(made, alarmed)
        cancelled(made)
    else:
        made.end("reach", ImError("no way", code="way"))
    (result,) = made.results
    assert str(result.error) == ("interrupted by an alarm" if then == "fail" else "no way")
    assert made.marking("n") == {"idle": 2}


@pytest.mark.parametrize("when", ["running", "interrupted", "doing"])
def test_a_cancelled_command_is_not_begun_again(when):
    made, alarmed, executor = process("restart")
    number = made.command("n", "go")
    cancel = CommandCancelled(number, ImError("enough", code="cancelled"))
    if when == "running":
        executor.post(cancel)
        made.pump()
        strike(made, alarmed)
        cancelled(made)
    else:
        strike(made, alarmed)
        if when == "doing":
            cancelled(made)
        executor.post(cancel)
        made.pump()
        made.end("reach.alarm.do_1") if when == "doing" else cancelled(made)
    assert [result.error is None for result in made.results] == [False]
    assert made.recorder.names("n").count("reach+") == 1
    assert made.marking("n") == {"idle": 2}


def test_an_action_that_does_not_obey_comes_in_doubt_and_ends_as_any_other():
    made = Process(
        [parse_net(NET.replace("THEN", "restart").replace("action: reach,", "action: reach, timeout: 1.0,"))],
        {"reach": hold, "say": hold},
        {"alarmed": lambda ctx: True},
        clock=Clock(),
    )
    made.answers["reach"] = Answer(Outcome.UNKNOWN)
    made.command("n", "go")
    assert made.marking("n")["reach.cancelling"] == 1
    made.wait(1.5)
    assert "reach?" in made.recorder.names("n")
    assert [held[1].transition for held in made.held if held[1].transition != "reach"] == ["reach.alarm.do_1"]


@pytest.mark.parametrize("acting", ["reach.one", "reach.two"])
def test_a_subnet_is_interrupted_in_whichever_of_its_actions_it_is(acting):
    text = NET.replace("action: reach, on_failure", "use: way, on_failure").replace("THEN", "fail") + (
        "templates:\n  way:\n    ports: {in: a, out: c, on_failure: d}\n    places: {b: }\n    transitions:\n"
        "      one: {in: a, out: b, action: reach, on_failure: d}\n"
        "      two: {in: b, out: c, action: reach, on_failure: d}\n"
    )
    alarmed = [False]
    made = Process([parse_net(text)], {"reach": hold, "say": lambda ctx: None}, {"alarmed": lambda ctx: alarmed[0]})
    made.command("n", "go")
    if acting == "reach.two":
        made.end("reach.one")
    strike(made, alarmed)
    assert made.marking("n")[f"{acting}.cancelling"] == 1
    made.end(acting, ImError("stopped", code="cancelled"))
    assert str(made.results[0].error) == "interrupted by an alarm"


def test_rules_may_stand_in_a_file_beside_the_net_and_the_net_is_flat(tmp_path):
    rules = NET[NET.index("interrupts") : NET.index("transitions")]
    (tmp_path / "rules.yaml").write_text(rules.replace("THEN", "skip"))
    (tmp_path / "n.yaml").write_text("include: rules.yaml" + NET.replace(rules, ""))
    read = load_net(tmp_path / "n.yaml")
    assert read.transitions.keys() == parse_net(NET.replace("THEN", "skip")).transitions.keys()
    assert read.transitions["reach.alarm.stop"].cancels == "reach"
    again = parse_net(yaml_text(read))
    assert {name: t.cancels for name, t in again.transitions.items()} == {
        name: t.cancels for name, t in read.transitions.items()
    }
    stop = expand(read).transitions["reach.alarm.stop"]
    assert stop.inputs == {"reach.alarm.armed": 1, "reach.active": 1}
    assert stop.outputs == {"reach.alarm.stopped": 1, "reach.cancelling": 1}


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        (
            "during: reach",
            "during: raech",
            r"net:6:19: during: there is no transition 'raech' \(did you mean 'reach'\?\)",
        ),
        ("if: alarmed, ", "", "has neither 'watch' nor 'if'"),
        ("then: THEN", "then: again", "then: Input should be 'restart', 'skip', 'fail' or 'continue', not 'again'"),
        ("do: [{action: say}], then: THEN", "then: continue", "'continue' needs something to do"),
        ("{action: say}", "{action: say, in: idle}", "'in' of what an interrupt does follows from the interrupt"),
        ("{action: say}", "say", "'say' is not a mapping"),
        ("in: wanted, out: there", "in: [wanted, idle], out: there", "an interrupt needs one place in each of in, out"),
        ("action: reach,", "action: reach, tries: 2,", "'tries' does not go together with an interrupt of reach"),
        ("if: alarmed", "if: alarmed, watch: {name: /a, type: std_msgs/msg/Bool}", "is not a condition"),
        ("if: alarmed", "if: '${message.data}'", "there is no value 'message'"),
        ("action: reach, on_failure: failed", "on_failure: failed", "has no action that an interrupt could end"),
        ("in: there, out: idle", "in: there, out: idle, cancels: begin", "'begin' is no transition with an action"),
        ("in: there, out: idle", "in: there, out: idle, cancels: raech", r"is no transition \(did you mean 'reach'"),
        ("in: there, out: idle", "in: there, out: idle, cancels: reach, delay: 1", "not go together with 'delay'"),
    ],
)
def test_mistakes_are_named(find, replace, complaint):
    assert find in NET
    with pytest.raises(NetFileError, match=complaint):
        parse_net(NET.replace(find, replace, 1).replace("THEN", "skip"))


def test_a_request_is_taken_back_and_the_other_net_ends_its_action():
    front = parse_net(NET.replace("THEN", "fail").replace("action: reach", "request: m.move"))
    back = parse_net(
        "net: m\nplaces: {asked: , moved: , missed: }\nservices: {move: {entry: asked, done: moved, failed: missed}}\n"
        "transitions: {move: {in: asked, out: moved, action: drive, on_failure: missed}}"
    )
    alarmed = [False]
    functions = {"drive": hold, "say": lambda ctx: None}
    made = Process([front, back], functions, {"alarmed": lambda ctx: alarmed[0]})
    made.command("n", "go")
    strike(made, alarmed)
    assert (made.marking("n")["reach.cancelling"], made.marking("m")["move.cancelling"]) == (1, 1)
    made.end("move", ImError("the drive was cancelled", code="cancelled"))
    assert str(made.results[0].error) == "interrupted by an alarm"
    assert made.marking("n") == {"idle": 2}
    assert made.marking("m") == {"SI": 1, "SO": 1}
