"""The Gripper Coordinator, whose net says it all: which gripper, how wide, how hard, and what became of it."""

import pytest

from im_cell.robot import load_cell
from im_core.config import package_file
from im_pnt.model.action import GoalAction
from im_pnt.netfile import load_net, parse_net
from support.process import Process

ASKS = """\
net: asks
commands: {{go: {{}}}}
places: {{idle: {{tokens: 1, resource: true}}, done: , bad: }}
escalate: bad
transitions:
  ask:
    symbol: go
    in: idle
    out: done
    request: {{to: gripper_coordinator.{service}, arguments: {arguments}}}
    result: {result}
  end: {{in: done, out: idle, emit: go_done}}
  fail: {{in: bad, out: idle, emit: go_failed}}
"""
OPEN = '{width: "${answers.ask.width}", force: "${answers.ask.force}"}'
CLOSE = '{width: "${answers.ask.width}", force: "${answers.ask.force}", gripped: "${answers.ask.gripped}"}'


def asked(service, arguments, answer):
    """What is sent to MCS, which gives an answer, and how the command ends."""
    sent = []

    async def perform(activity, context):
        name, fields = await context.filled([activity.action.name, activity.action.fields])
        sent.append((activity.transition, name, fields))
        return answer

    served = load_net(package_file("im_coordinators", "nets/gripper_coordinator.yaml"))
    result = OPEN if service == "open_gripper" else CLOSE
    process = Process(
        [served, parse_net(ASKS.format(service=service, arguments=arguments, result=result))],
        actions={"while_powered": lambda ctx: {}},
        others={GoalAction: perform},
    )
    process.command("asks", "go")
    (ended,) = process.results
    return sent, ended


def at(width, force=0.0, stalled=False):
    """What the jaws came to, as of control_msgs/action/GripperCommand."""
    return {"position": width, "effort": force, "stalled": stalled, "reached_goal": not stalled}


@pytest.mark.parametrize(
    ("service", "arguments", "side", "command"),
    [
        ("open_gripper", "{gripper: left_gripper}", "left", {"position": 0.08, "max_effort": 0.0}),
        (
            "open_gripper",
            "{gripper: right_gripper, width: 0.02, force: 40}",
            "right",
            {"position": 0.02, "max_effort": 40},
        ),
        ("close_gripper", "{gripper: left_gripper}", "left", {"position": 0.0, "max_effort": 0.0}),
        (
            "close_gripper",
            "{gripper: right_gripper, width: 0.03, force: 5}",
            "right",
            {"position": 0.03, "max_effort": 5},
        ),
    ],
)
def test_the_gripper_that_is_named_gets_what_is_asked(service, arguments, side, command):
    sent, ended = asked(service, arguments, at(command["position"]))
    assert sent == [(service.partition("_")[0], f"/{side}_gripper/gripper_cmd", {"command": command})]
    assert ended.success


def test_how_wide_it_is_and_whether_something_is_gripped_is_told_as_it_is():
    empty = asked("close_gripper", "{gripper: left_gripper, width: 0.02}", at(0.0201))[1]
    assert (empty.success, empty.results) == (True, {"width": 0.0201, "force": 0.0, "gripped": False})
    around = asked("close_gripper", "{gripper: left_gripper, width: 0.02}", at(0.0496, 40.0, stalled=True))[1]
    assert (around.success, around.results) == (True, {"width": 0.0496, "force": 40.0, "gripped": True})
    opened = asked("open_gripper", "{gripper: right_gripper, width: 0.06}", at(0.0599))[1]
    assert (opened.success, opened.results) == (True, {"width": 0.0599, "force": 0.0})


def test_jaws_that_do_not_open_as_wide_as_asked_are_a_failure():
    held = asked("open_gripper", "{gripper: right_gripper, width: 0.06}", at(0.0412, stalled=True))[1]
    assert not held.success
    assert str(held.error) == "right_gripper is held up at 41 mm; 60 mm was asked"


@pytest.mark.parametrize(
    ("package", "net"),
    [
        ("im_coordinators", "gripper_coordinator"),
        ("im_dispatcher", "open_gripper"),
        ("im_dispatcher", "close_gripper"),
    ],
)
def test_what_may_be_asked_is_what_the_gripper_can_do(package, net):
    gripper, read = load_cell().gripper, load_net(package_file(package, f"nets/{net}.yaml"))
    declared = [*read.commands.values(), *read.services.values()]
    assert declared
    for schema in (each.arguments.arguments for each in declared):
        width, force = schema["width"], schema["force"]
        assert (width.unit, width.minimum, width.maximum) == ("m", 0.0, gripper.stroke)
        assert (force.unit, force.minimum, force.maximum) == ("N", 0.0, gripper.force)


def test_a_gripper_that_there_is_not_is_refused():
    served = load_net(package_file("im_coordinators", "nets/gripper_coordinator.yaml"))
    asks = parse_net(ASKS.format(service="open_gripper", arguments="{gripper: third_gripper}", result=OPEN))
    process = Process([served, asks], actions={"while_powered": lambda ctx: {}})
    process.command("asks", "go")
    assert "argument gripper is 'third_gripper', not one of 'left_gripper'" in str(process.results[0].error)
