"""Service calls, action goals and data objects as parts of transitions; nets that are refused at load."""

import json
import os
import re
import threading

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import SetBool
from unique_identifier_msgs.msg import UUID

from im_core import clock, unfinished_commands
from im_core.errors import ConfigError, LinkError
from im_core.ros import qos
from im_core.ros.calls import call_blocking, pause
from im_core.ros.guard import GuardedActionClient
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_msgs.action import ExecuteCommand, Move
from im_msgs.msg import Firing, ObjectChange, Status, TaskStatus
from im_msgs.srv import ControlCommand, GetObject, ListCommands
from im_pnt.errors import NetFileError
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.functions import ActionContext
from im_pnt.expression.scope import check_net
from im_pnt.model.action import GoalAction
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.commands import notes
from im_pnt_node.ros.execution.actions import SETTLING_S
from im_pnt_node.ros.execution.goals import GoalActions, read_remap
from im_pnt_node.ros.messages import RosTypes
from im_pnt_node.ros.node import PntNode
from support.forgetful import forget
from support.loop import in_loop

NET = """
net: worker
commands:
  flip: {arguments: {on: {type: boolean}, loud: {type: integer, default: 3}}}
places:
  idle: 1
  ready:
  trouble:
  flipped:
  told:
  path_valid: {data_object: path, on_invalid: [trouble]}
  set_out:
interrupts:
  halt:
    during: drive
    watch: {name: /hardware/events, type: std_msgs/msg/String}
    if: ${message.data == 'halt'}
    do: [{topic: {name: /hardware/shouts, type: std_msgs/msg/String, message: {data: halt}}}]
    then: skip
transitions:
  begin_drive: {in: idle, out: set_out, symbol: drive}
  drive:
    {in: set_out, out: ready, on_failure: trouble,
     goal: {name: /hardware/move, type: im_msgs/action/Move, build: path}}
  switch:
    {in: idle, out: ready, symbol: switch, on_failure: trouble,
     service: {name: /hardware/switch, type: std_srvs/srv/SetBool, build: wanted, handle: note}}
  ended:
    {in: ready, out: idle,
     emit: [switch_done, slow_done, move_done, shout_done, follow_done, hear_done, sense_done, read_done, last_done,
            until_done, elsewhere_done, mine_done, drive_done]}
  move:
    {in: idle, out: ready, symbol: move, on_failure: trouble,
     goal: {name: /hardware/move, type: im_msgs/action/Move, build: path}}
  mine:
    {in: idle, out: ready, symbol: mine, on_failure: trouble,
     goal: {name: /mine/move, type: im_msgs/action/Move, build: path}}
  plan: {in: idle, out: path_valid, symbol: plan, action: nothing, on_failure: trouble}
  planned: {in: path_valid, out: idle, guard: not keep, emit: plan_done}
  slow:
    {in: idle, out: ready, symbol: slow, timeout: 0.3, on_failure: trouble,
     service: {name: /hardware/slow, type: std_srvs/srv/SetBool, build: pace}}
  shout:
    {in: idle, out: ready, symbol: shout, on_failure: trouble,
     topic: {name: /hardware/shouts, type: std_msgs/msg/String, message: {data: ho}}}
  forbidden:
    {in: idle, out: ready, symbol: forbidden, on_failure: trouble,
     goal: {name: /hardware/forbidden, type: control_msgs/action/FollowJointTrajectory}}
  absent:
    {in: idle, out: ready, symbol: absent, on_failure: trouble,
     goal: {name: /nowhere/move, type: im_msgs/action/Move}}
  elsewhere:
    {in: idle, out: ready, symbol: elsewhere, on_failure: trouble,
     goal: {name: /elsewhere/follow, type: control_msgs/action/FollowJointTrajectory}}
  follow:
    {in: idle, out: ready, symbol: follow, on_failure: trouble,
     goal: {name: /hardware/follow, type: control_msgs/action/FollowJointTrajectory}}
  hush:
    {in: idle, out: ready, symbol: hush, on_failure: trouble,
     await: {name: /hardware/nothing, type: std_msgs/msg/String, silent: 0.5}}
  hear:
    {in: idle, out: ready, symbol: hear, on_failure: trouble, timeout: 30.0,
     await: {name: /hardware/events, type: std_msgs/msg/String, handle: heard}}
  sense:
    {in: idle, out: ready, symbol: sense, on_failure: trouble, timeout: 30.0,
     await: {name: /hardware/stream, type: std_msgs/msg/String, handle: heard}}
  read:
    {in: idle, out: ready, symbol: read, on_failure: trouble, timeout: 30.0,
     await: {name: /hardware/state, type: std_msgs/msg/String, latched: true, handle: heard}}
  last:
    {in: idle, out: ready, symbol: last, on_failure: trouble, timeout: 30.0,
     await: {name: /hardware/fresh, type: std_msgs/msg/String, latched: true, handle: heard}}
  until:
    {in: idle, out: ready, symbol: until, on_failure: trouble, timeout: 30.0, result: {heard: "${answers.until.data}"},
     await: {name: /hardware/events, type: std_msgs/msg/String, until: "${answers.until.data in command.symbol}"}}
  vain:
    {in: idle, out: ready, symbol: vain, on_failure: trouble, timeout: 0.2,
     await: {name: /hardware/nothing, type: std_msgs/msg/String}}
  endless:
    {in: idle, out: ready, symbol: endless, on_failure: trouble,
     await: {name: /hardware/nothing, type: std_msgs/msg/String}}
  flip:
    {in: idle, out: flipped, symbol: flip, on_failure: trouble,
     service: {name: /hardware/switch, type: std_srvs/srv/SetBool, request: {data: "${arguments.on}"}}}
  cry:
    {in: flipped, out: told, on_failure: trouble,
     guard: "${answers.flip.message == 'on' and arguments.loud > 2}",
     topic: {name: /hardware/cries, type: std_msgs/msg/String, message: {data: "it is ${answers.flip.message}"}}}
  whisper:
    {in: flipped, out: told, guard: "not ${answers.flip.message == 'on' and arguments.loud > 2}"}
  flop:
    {in: told, out: idle, emit: flip_done, on_failure: trouble,
     result: {said: "${answers.flip.message}", louder: "${arguments.loud + 1}"}}
  give_up: {in: trouble, out: idle}
"""


class Hardware(ManagedNode):
    """Answers services and goals as the test wants."""

    def __init__(self, **kwargs):
        super().__init__("hardware", **kwargs)
        self.valid = True
        self.goals = []
        self.create_service(SetBool, "/hardware/switch", self._switch)
        self.create_service(SetBool, "/hardware/slow", self._slow)
        self.create_service(GetObject, "/dom/get", self._get)
        self.changes = self.create_publisher(ObjectChange, "/dom/changes", qos.LATCHED_EVENTS)
        self.refusals = 0
        ActionServer(self, FollowJointTrajectory, "/hardware/follow", self._trajectory)
        refuse = {"goal_callback": lambda _: GoalResponse.REJECT}
        ActionServer(self, FollowJointTrajectory, "/hardware/forbidden", self._trajectory, **refuse)
        self.code = self.followed = 0
        self.events = self.create_publisher(String, "/hardware/events", qos.EVENTS)
        self.stream = self.create_publisher(String, "/hardware/stream", qos.SENSOR)
        self.fresh = self.create_publisher(String, "/hardware/fresh", qos.SENSOR)  # no message of another test is late
        self.state = self.create_publisher(String, "/hardware/state", qos.LATCHED)
        ActionServer(self, Move, "/hardware/move", self._move, cancel_callback=self._may_cancel)

    def _switch(self, request, response):
        response.success = request.data
        response.message = "on" if request.data else "the fuse has blown"
        return response

    async def _slow(self, request, response):
        await pause(self, 3.0 if request.data else 0.7)
        response.success = True
        return response

    def _get(self, request, response):
        response.success, response.status.code = self.valid, "ok" if self.valid else "state"
        return response

    async def _trajectory(self, goal):
        self.followed += 1
        goal.succeed()
        words = "left_j3 was 0.2 rad behind" if self.code else ""
        return FollowJointTrajectory.Result(error_code=self.code, error_string=words)

    def _may_cancel(self, goal):
        self.refusals -= 1
        return CancelResponse.REJECT if self.refusals >= 0 else CancelResponse.ACCEPT

    async def _move(self, goal):
        self.goals.append(goal.request)
        if goal.request.speed_scale > 0.5:
            goal.abort()
            return Move.Result(success=False, status=Status(code="limit", message="left_j3: too fast"))
        for _ in range(3000):
            if goal.is_cancel_requested:
                goal.canceled()
                return Move.Result()
            await pause(self, 0.02)
        goal.succeed()
        return Move.Result(success=True)


class Doubtful:
    """An action of which it is not known what became."""

    def __init__(self, action):
        self.action, self.begun_as, self.net, self.number = action, "before/worker", "worker", 1


def path(ctx):
    points = [{"positions": [0, 1.5]}, {"positions": [1.0, 2.0]}]
    return {"path": {"joint_names": ["a", "b"], "points": points}, "speed_scale": ctx.command.arguments["speed"]}


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    file = tmp_path_factory.mktemp("nets") / "worker.yaml"
    file.write_text(NET)
    rclpy.init()
    alone = [Parameter("standalone", value=True)]
    hardware = Hardware(parameter_overrides=alone)
    noted, keep = [], [False]
    functions = {
        "wanted": lambda ctx: {"data": ctx.command.arguments["on"]},
        "note": lambda ctx, response: noted.append(response.message),
        "path": path,
        "heard": lambda ctx, message: ctx.result.update(heard=message.data),
        "pace": lambda ctx: {"data": ctx.command.arguments["very"]},
        "nothing": lambda ctx: None,
    }
    guards = {"keep": lambda ctx: keep[0]}
    given = [*alone, Parameter("remap", value="/mine/move:=/hardware/move")]
    node = PntNode("worker", [file], functions, guards, verifier=verify_to_load, parameter_overrides=given)
    with spin_in_thread(hardware, node):
        deadline = clock.monotonic() + 60.0
        while not node.ready and clock.monotonic() < deadline:
            clock.sleep(0.02)
        yield node, hardware, noted, keep
    rclpy.try_shutdown()


def run(node, symbol, cancel_after=None, after=None, **arguments):
    ended, outcome, numbers = threading.Event(), [], []

    async def work():
        outcome.append(await node.commands.run(symbol, arguments, started=numbers.append))
        ended.set()

    node.executor.create_task(work())
    node.wake()
    if after is not None:
        after()
    if cancel_after is not None:
        while not numbers:
            clock.sleep(0.0001)
        clock.sleep(cancel_after)
        node.commands.cancel(numbers[0])
    assert ended.wait(60.0), f"command {symbol} did not end"
    return outcome[0]


def test_a_service_is_called_with_built_fields_and_its_answer_is_handled(machine):
    node, _, noted, _ = machine
    assert run(node, "switch", on=True).success
    assert noted == ["on"]
    outcome = run(node, "switch", on=False)
    assert (outcome.success, outcome.status.message) == (False, "the fuse has blown")


def test_a_field_that_does_not_fit_is_named(machine):
    outcome = run(machine[0], "switch", on="perhaps")
    assert "service /hardware/switch.data (boolean) cannot be 'perhaps'" in outcome.status.message


def test_a_goal_that_is_rejected_names_who_did(machine):
    outcome = run(machine[0], "forbidden")
    assert not outcome.success
    assert outcome.status.message == "goal /hardware/forbidden was rejected by hardware"


def test_a_goal_that_its_server_has_already_is_followed_not_lost(machine, monkeypatch):
    """A node whose journal has lost its end sends a goal once more; the server rejects what it has."""
    monkeypatch.setattr(GoalActions, "_goal_id", lambda *_: UUID(uuid=[7] * 16))
    assert run(machine[0], "follow").success
    assert run(machine[0], "follow").success


def test_a_goal_that_its_server_has_forgotten_names_who_did(machine, monkeypatch):
    """Whoever asks for the result again may meet the next incarnation of the server before it is heard of."""
    forget(monkeypatch, 1)
    outcome = run(machine[0], "move", speed=0.1)
    assert (outcome.success, outcome.status.code) == (False, "link")
    assert "hardware does not know goal /hardware/move any more: it was started again" in outcome.status.message
    assert run(machine[0], "follow").success


def test_a_goal_of_which_nobody_can_tell_any_more_is_not_followed(machine, monkeypatch):
    """Its server has died, and owes no result: that would be kept for ever."""
    goals, result = machine[0]._runner._kinds[GoalAction], Future()
    activity = Doubtful(GoalAction("/hardware/move", "im_msgs/action/Move"))

    async def died(*_):
        raise LinkError("hardware is missing", task="hardware")

    monkeypatch.setattr(goals, "_follow", lambda *_: result)
    monkeypatch.setattr(goals._surroundings, "wait", died)
    answer = in_loop(machine[0], goals.ask, activity, ActionContext("machine", "move"))
    assert answer == Answer(Outcome.UNKNOWN, asked="hardware is missing")
    assert not goals._results
    assert result.cancelled()


def test_a_net_that_was_loaded_again_sends_goals_of_its_own(machine):
    """They had the ids of those before; the server knew these, and the first result counted for another goal."""
    node, hardware, _, _ = machine
    before = hardware.followed
    for _ in range(2):
        assert run(node, "follow").success
        assert in_loop(node, node.load_net, parse_net(NET)) is not None, "it was refused"
    assert run(node, "follow").success
    assert hardware.followed == before + 3


def test_a_server_whose_task_starts_is_asked_when_it_has_come_to_the_end_of_that(machine, wait_until):
    """What it serves is there before: it would refuse what it cannot do yet."""
    node, hardware, noted, _ = machine
    wait_until(lambda: node.heartbeats.incarnation("hardware") == hardware.incarnation, "a heartbeat")
    noted.clear()
    hardware._set_phase(TaskStatus.CONFIGURED, "")
    wait_until(lambda: node.heartbeats.starting("hardware"), "the phase")
    _, outcomes = begin(node, "switch", on=True)
    clock.sleep(1.0)
    assert (noted, outcomes) == ([], [])
    hardware._set_phase(TaskStatus.READY, "")
    wait_until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success
    assert noted == ["on"]


def test_who_does_not_come_to_the_end_of_its_start_is_named(machine, monkeypatch, wait_until):
    node, hardware, _, _ = machine
    monkeypatch.setattr("im_pnt_node.ros.execution.actions.patience_s", lambda: 1.0)
    hardware._set_phase(TaskStatus.LOADED, "")
    wait_until(lambda: node.heartbeats.starting("hardware"), "the phase")
    message = run(node, "switch", on=True).status.message
    hardware._set_phase(TaskStatus.READY, "")
    assert message.endswith("is not there: hardware has not come to the end of its start")
    wait_until(lambda: not node.heartbeats.starting("hardware"), "the phase")


def test_a_server_whose_task_is_silent_is_asked_when_it_is_heard_again(machine, monkeypatch, wait_until):
    node, hardware, noted, _ = machine
    monkeypatch.setattr("im_core.ros.heartbeats.SILENCE_S", 2.0)
    noted.clear()
    hardware._heartbeat.cancel()
    try:
        wait_until(lambda: node.heartbeats.missing("hardware"), "the silence")
        outcome = run(node, "switch", cancel_after=1.0, on=True)
        _, outcomes = begin(node, "switch", on=True)
        clock.sleep(1.0)
        assert (noted, outcomes) == ([], [])
    finally:
        hardware._heartbeat.reset()
    assert outcome.status.message == "service /hardware/switch was cancelled before it was sent"
    wait_until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success
    assert noted == ["on"]


def test_a_service_that_answers_a_little_late_has_answered(machine):
    assert run(machine[0], "slow", very=False).success


def test_a_service_that_does_not_answer_leaves_the_transition_in_doubt(machine, wait_until):
    node, _, _, _ = machine
    phases = []
    node.create_subscription(Firing, "/pnt/firings", lambda f: phases.append((f.transition, f.phase)), qos.EVENTS)
    outcome = run(node, "slow", very=True)
    assert outcome.status.code == "in_doubt"
    assert "the outcome of service /hardware/slow of transition slow of net worker is unknown: waited 0.3" in (
        outcome.status.message
    )
    wait_until(lambda: ("slow", Firing.FAILED) in phases, "the end of the transition")
    assert [phase for transition, phase in phases if transition == "slow"] == [
        Firing.START,
        Firing.DOUBT,
        Firing.FAILED,
    ]


def test_a_message_is_published(machine, wait_until):
    node, hardware, _, _ = machine
    heard = []
    ears = hardware.create_subscription(
        String, "/hardware/shouts", lambda message: heard.append(message.data), qos.EVENTS
    )
    wait_until(ears.get_publisher_count, "the publisher")
    assert run(node, "shout").success
    wait_until(lambda: heard, "the message")
    assert heard == ["ho"]


def test_a_net_in_yaml_alone_sends_arguments_looks_at_the_answer_sends_it_on_and_returns_it(machine):
    node, hardware, _, _ = machine
    heard = []
    hardware.create_subscription(String, "/hardware/cries", lambda message: heard.append(message.data), qos.EVENTS)
    outcome = run(node, "flip", on=True, loud=2)
    assert outcome.results == {"said": "on", "louder": 3}
    deadline = clock.monotonic() + 60.0
    while not heard and clock.monotonic() < deadline:  # until the two have discovered each other
        outcome = run(node, "flip", on=True)
        assert outcome.results == {"said": "on", "louder": 4}
        clock.sleep(0.05)
    assert set(heard) == {"it is on"}
    outcome = run(node, "flip", on=False)
    assert (outcome.success, outcome.status.message) == (False, "the fuse has blown")


def test_messages_are_checked_at_load_against_their_types():
    for find, replace, complaint in (
        (
            "{data: ho}",
            "{dat: ho}",
            r"shout.topic.message.dat: std_msgs/msg/String has no field 'dat' \(did you mean 'da",
        ),
        ("{data: ho}", "{data: 5}", "shout.topic.message.data: '5' is not a text"),
        (
            "it is ${answers.flip.message}",
            "${answers.flip.success}",
            "cry.topic.message.data: .* is true or false, not",
        ),
        ("answers.flip.message == 'on'", "answers.flip.massage == 'on'", "has no field 'massage'"),
        ('data: "${arguments.on}"', 'data: "${arguments.loud}"', "is a whole number, not true or false"),
        (
            "std_msgs/msg/String, latched",
            "std_mgs/msg/String, latched",
            "read.await.type: .* 'std_mgs'.* sourced before",
        ),
        ("control_msgs/action/FollowJ", "control_msgs/action/FollowJJ", "no action type of control_msgs 'FollowJJoint"),
    ):
        assert find in NET
        with pytest.raises(NetFileError, match=rf"^worker:\d+:\d+: transitions.*{complaint}"):
            check_net(parse_net(NET.replace(find, replace), "worker"), RosTypes())


def test_a_goal_is_filled_from_plain_data_and_its_abortion_carries_the_status(machine):
    node, hardware, _, _ = machine
    outcome = run(node, "move", speed=1)
    assert (outcome.status.code, outcome.status.message) == ("limit", "left_j3: too fast")
    assert list(hardware.goals[-1].path.points[0].positions) == [0.0, 1.5]
    assert hardware.goals[-1].path.joint_names == ["a", "b"]


def test_cancelling_a_command_cancels_its_goal(machine):
    outcome = run(machine[0], "move", cancel_after=0.4, speed=0.1)
    assert outcome.status.code == "cancelled"
    assert "goal /hardware/move was cancelled" in outcome.status.message


@pytest.mark.parametrize("after", [0.0, 0.001, 0.003, 0.01])
def test_a_cancellation_that_meets_the_acceptance_of_its_goal_is_not_lost(machine, after):
    assert run(machine[0], "move", cancel_after=after, speed=0.1).status.code == "cancelled"


def test_a_cancellation_that_the_server_refuses_at_first_is_asked_for_again(machine):
    node, hardware, _, _ = machine
    hardware.refusals = 3
    assert run(node, "move", cancel_after=0.2, speed=0.1).status.code == "cancelled"
    assert hardware.refusals == -1


def test_an_action_is_reached_under_its_new_name_cancelled_there_and_named_so(machine, wait_until):
    node, hardware, _, _ = machine
    begun = len(hardware.goals)
    number, outcomes = begin(node, "mine", speed=0.1)
    wait_until(lambda: len(hardware.goals) > begun, "the goal")
    in_loop(node, lambda: node.commands.cancel(number))
    wait_until(lambda: outcomes, "the end of the command")
    assert outcomes[0].status.code == "cancelled"
    assert outcomes[0].status.message.startswith("goal /hardware/move was cancelled")


def test_new_names_of_actions_are_full_and_each_old_one_has_one():
    assert read_remap("/arm/grip:=/x/grip, /arm/move:=/x/move") == {"/arm/grip": "/x/grip", "/arm/move": "/x/move"}
    assert read_remap("") == {}
    for text, sentence in (
        ("/arm/grip=/x/grip", "remap /arm/grip=/x/grip is not of the form /old:=/new"),
        ("arm/grip:=/x/grip", "is not of the form /old:=/new, full names of actions"),
        ("/a:=/b,/a:=/c", "remap gives /a two names, /b and /c"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            read_remap(text)


def test_an_action_that_nobody_offers_is_named_at_once(machine):
    message = run(machine[0], "absent").status.message
    assert message.startswith(f"nobody offers the action /nowhere/move in ROS domain {os.environ['ROS_DOMAIN_ID']} (")
    assert "/hardware/move" in message, "the only one of its type"


def test_a_server_that_was_there_is_waited_for_also_before_it_was_needed(machine, wait_until):
    node, hardware, _, _ = machine
    name, kind = "/elsewhere/follow", "control_msgs/action/FollowJointTrajectory"
    server = node._runner._kinds[GoalAction].prepare(GoalAction(name, kind))
    first = ActionServer(hardware, FollowJointTrajectory, name, hardware._trajectory)
    wait_until(lambda: server.found, "the server")
    first.destroy()
    wait_until(lambda: not server.ready(), "the server to go")
    _, outcomes = begin(node, "elsewhere")
    clock.sleep(1.5 * SETTLING_S)
    assert outcomes == []
    second = ActionServer(hardware, FollowJointTrajectory, name, hardware._trajectory)
    wait_until(lambda: outcomes, "the end of the command")
    second.destroy()
    assert outcomes[0].success


def test_two_servers_of_one_name_are_asked_nothing(machine, monkeypatch):
    """Each would carry out the goal: two robots without namespaces, or one that was left in the background."""
    node, hardware, _, _ = machine
    monkeypatch.setattr("im_pnt_node.ros.execution.actions.SUCCESSION_S", 1e6)  # two that live are no succession
    twin, goals = rclpy.create_node("twin"), []
    servers = [
        ActionServer(each, FollowJointTrajectory, "/elsewhere/follow", hardware._trajectory,
                     goal_callback=lambda goal: goals.append(goal) or GoalResponse.ACCEPT)
        for each in (hardware, twin)
    ]  # fmt: skip
    message = run(node, "elsewhere").status.message
    for server in servers:
        server.destroy()
    twin.destroy_node()
    assert "2 nodes serve the action /elsewhere/follow: /hardware, /twin; nothing is sent" in message
    assert goals == []


def test_a_second_server_that_is_discovered_while_the_first_settles_counts(machine, monkeypatch):
    node, hardware, _, _ = machine
    settled = []

    async def settle(waiting, seconds):
        settled.append(seconds)
        await pause(waiting, 0.01)

    known = {"servers_of": lambda *_: ["/hardware", "/twin"][: 1 + bool(settled)], "sure_to_live": lambda *_: 2}
    for name, value in {**known, "pause": settle, "SETTLING_S": 1e6}.items():
        monkeypatch.setattr(f"im_pnt_node.ros.execution.actions.{name}", value)
    server = ActionServer(hardware, FollowJointTrajectory, "/elsewhere/follow", hardware._trajectory)
    wait = node._runner._kinds[GoalAction].prepare(
        GoalAction("/elsewhere/follow", "control_msgs/action/FollowJointTrajectory")
    )
    while not wait.ready():
        clock.sleep(0.02)
    message = run(node, "elsewhere").status.message
    server.destroy()
    assert "2 nodes serve the action /elsewhere/follow: /hardware, /twin; nothing is sent" in message
    assert settled[0] > 1e3


@pytest.mark.parametrize("waits", [True, False])
def test_who_goes_on_after_a_death_waits_for_servers_that_may_have_died_too(machine, monkeypatch, waits):
    monkeypatch.setattr("im_pnt_node.ros.execution.actions.DISCOVERY_TIMEOUT_S", 1.0)
    monkeypatch.setattr(machine[0]._runner.surroundings, "waits_for_all", waits)
    message = run(machine[0], "absent").status.message
    assert ("the action /nowhere/move is not there: waited 1 s for it" in message) == waits


def test_a_data_place_is_marked_only_if_the_object_is_valid_and_unmarked_when_it_is_not_any_more(machine, wait_until):
    node, hardware, _, keep = machine
    assert run(node, "plan").success
    hardware.valid = False
    assert re.search(r"data object worker/[\d-]+/path is not valid", run(node, "plan").status.message)
    hardware.valid, keep[0] = True, True
    named = []

    def invalidate():
        wait_until(lambda: node.exchange.nets["worker"].marking().get("path_valid"), "the mark of the data place")
        (scope,) = node.commands.scopes()
        named.append(f"{scope}/path")
        hardware.valid = False
        change = ObjectChange()
        change.object.name = named[0]
        hardware.changes.publish(change)

    outcome = run(node, "plan", after=invalidate)
    assert f"data object {named[0]} lost its validity" in outcome.status.message


def test_a_result_is_judged_by_the_error_code_that_its_type_names(machine):
    node, hardware, _, _ = machine
    assert run(node, "follow").success
    hardware.code = FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED
    outcome = run(node, "follow")
    assert outcome.status.code == "path_tolerance_violated"
    assert outcome.status.message.endswith("PATH_TOLERANCE_VIOLATED (-4): left_j3 was 0.2 rad behind")


def begin(node, symbol, **arguments):
    """A command that has begun: the node knows its number, and its action runs."""
    numbers, outcomes = [], []

    async def work():
        outcomes.append(await node.commands.run(symbol, arguments, started=numbers.append))

    node.spawn(work())
    deadline = clock.monotonic() + 60.0
    while not any(a.transition == symbol for a in node.exchange.nets["worker"].activities):
        assert clock.monotonic() < deadline, f"{symbol} did not begin"
        clock.sleep(0.01)
    return numbers[0], outcomes


@pytest.mark.parametrize(("symbol", "topic"), [("hear", "events"), ("sense", "stream")])
def test_a_message_is_awaited_from_publishers_of_either_quality(machine, wait_until, symbol, topic):
    node, hardware, _, _ = machine
    publisher = getattr(hardware, topic)
    publisher.publish(String(data="too early"))
    clock.sleep(0.3)
    _, outcomes = begin(node, symbol)

    def came():
        publisher.publish(String(data="now"))
        return outcomes

    assert wait_until(came, f"a message of {topic}")[0].results == {"heard": "now"}


def test_what_was_latched_before_counts_where_it_is_asked_for(machine, wait_until):
    node, hardware, _, _ = machine
    hardware.state.publish(String(data="open"))
    _, outcomes = begin_or_ended(node, "read")
    assert wait_until(lambda: outcomes, "what was latched")[0].results == {"heard": "open"}


def test_a_topic_that_is_not_latched_is_heard_all_the_same_where_that_was_asked_for(machine, wait_until):
    node, hardware, _, _ = machine
    _, outcomes = begin_or_ended(node, "last")

    def came():
        hardware.fresh.publish(String(data="next"))
        return outcomes

    assert wait_until(came, "the next message")[0].results == {"heard": "next"}


def test_a_message_interrupts_a_goal_and_nothing_is_left_of_the_watch(machine, wait_until):
    node, hardware, _, _ = machine
    sent = len(hardware.goals)
    _, outcomes = begin(node, "drive", speed=0.2)
    wait_until(lambda: len(hardware.goals) > sent, "the goal")

    def came():
        hardware.events.publish(String(data="nonsense"))
        hardware.events.publish(String(data="halt"))
        return outcomes

    assert wait_until(came, "the end of the interrupted goal")[0].success
    marking = node.exchange.nets["worker"].marking()
    assert (marking["idle"], [place for place in marking if "drive" in place]) == (1, [])
    refused = run(node, "drive", speed=0.9)
    assert refused.status.message.startswith("left_j3: too fast"), "a failure of its own is told as one"


def test_a_wait_on_a_topic_without_any_message_fails_where_that_was_asked_for(machine):
    outcome = run(machine[0], "hush")
    assert (outcome.success, outcome.status.code) == (False, "silent")
    assert outcome.status.message == "no message of /hardware/nothing came for 0.5 s"


def test_a_condition_over_a_field_that_the_type_does_not_have_is_refused():
    with pytest.raises(NetFileError, match=r"halt.watch.await.until: std_msgs/msg/String has no field 'dta'"):
        check_net(parse_net(NET.replace("${message.data == 'halt'}", "${message.dta == 'halt'}")), RosTypes())


def begin_or_ended(node, symbol):
    outcomes = []

    async def work():
        outcomes.append(await node.commands.run(symbol))

    node.spawn(work())
    return None, outcomes


def test_messages_that_do_not_fulfil_the_condition_are_passed_over(machine, wait_until):
    node, hardware, _, _ = machine
    _, outcomes = begin(node, "until")

    def came():
        hardware.events.publish(String(data="nonsense"))
        hardware.events.publish(String(data="until"))
        return outcomes

    assert wait_until(came, "the word")[0].results == {"heard": "until"}


def test_a_message_that_does_not_come_fails_by_its_timeout(machine):
    outcome = run(machine[0], "vain")
    assert outcome.status.code == "timeout"
    assert "message of /hardware/nothing of transition vain" in outcome.status.message


def test_a_wait_is_cancelled(machine, wait_until):
    node, _, _, _ = machine
    number, outcomes = begin(node, "endless")
    node.commands.cancel(number)
    outcome = wait_until(lambda: outcomes, "the end")[0]
    assert (outcome.success, outcome.status.code) == (False, "cancelled")


@pytest.fixture(scope="module")
def client(machine):
    """A client of the action that the node offers, and what it has told of its commands."""
    node, hardware, _, _ = machine
    told = []
    node.spawn(offer(node))
    hardware.create_subscription(String, "/worker/commands", lambda message: told.append(message.data), qos.LATCHED)
    found = GuardedActionClient(hardware, ExecuteCommand, "/worker/execute")
    assert found.wait_for_server(60.0)
    return found, told


async def offer(node):
    node.offer_commands()


def execute(client, symbol, arguments="", steps=None):
    """The handle of a goal that was accepted."""
    goal = ExecuteCommand.Goal(symbol=symbol, arguments=arguments)
    return completed(client.send_goal_async(goal, feedback_callback=lambda m: steps.append(m.feedback)))


def completed(future):
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(60.0)
    return future.result()


def test_anybody_in_ros_runs_a_command_and_is_told_of_its_steps(client):
    steps = []
    handle = execute(client[0], "switch", '{"on": true}', steps)
    answer = completed(handle.get_result_async())
    assert (answer.status, answer.result.success) == (GoalStatus.STATUS_SUCCEEDED, True)
    assert [feedback.step for feedback in steps if feedback.step][:1] == ["switch"]
    assert steps[0].command_id > 0


def test_the_number_of_a_command_is_told_when_it_is_written_down(machine, client, tmp_path, monkeypatch):
    """In the journal, and for the next start: whoever knows the number finds the command again after any death."""
    node, begun = machine[0], []

    def late(*note):
        begun.append(None)
        clock.sleep(0.5)
        unfinished_commands.note(*note)

    monkeypatch.setattr(notes, "note", late)
    monkeypatch.setattr(node.commands._notes, "_run_dir", tmp_path)
    found, told = [], threading.Event()

    def hear(message):
        found.append((message.feedback.command_id, [note.number for note in unfinished_commands.noted(tmp_path)]))
        told.set()

    goal = ExecuteCommand.Goal(symbol="move", arguments='{"speed": 0.1}')
    handle = completed(client[0].send_goal_async(goal, feedback_callback=hear))
    assert told.wait(60.0)
    assert begun
    assert found[0][1] == [found[0][0]]
    completed(handle.cancel_goal_async())
    completed(handle.get_result_async())


def test_anybody_in_ros_cancels_a_command(client):
    handle = execute(client[0], "move", '{"speed": 0.1}', [])
    completed(handle.cancel_goal_async())
    answer = completed(handle.get_result_async())
    assert (answer.status, answer.result.status.code) == (GoalStatus.STATUS_CANCELED, "cancelled")


def test_a_command_is_listed_paused_resumed_attached_to_and_cancelled_by_its_number(machine, client, wait_until):
    hardware, steps = machine[1], []
    listed = lambda: {c.command_id: c for c in call(hardware, ListCommands, "list_commands").commands}  # noqa: E731
    handle = execute(client[0], "move", '{"speed": 0.1}', steps)
    wait_until(lambda: steps, "the number of the command")
    number = steps[0].command_id
    wait_until(lambda: listed()[number].state == "running", "the command to run")
    assert listed()[number].arguments == '{"speed": 0.1}'
    assert control(hardware, number, "pause").success
    wait_until(lambda: listed()[number].state == "paused", "the command to be paused")
    assert "there is nothing to pause" in control(hardware, number, "pause").message
    assert control(hardware, number, "resume").success
    attached = completed(client[0].send_goal_async(ExecuteCommand.Goal(attach=True, command_id=number)))
    assert control(hardware, number, "cancel").success
    answers = [completed(each.get_result_async()).result for each in (handle, attached)]
    assert [answer.status.code for answer in answers] == ["cancelled", "cancelled"]
    assert number not in listed()
    again = completed(client[0].send_goal_async(ExecuteCommand.Goal(attach=True, command_id=number)))
    assert completed(again.get_result_async()).result.status.code == "cancelled"
    assert f"move (number {number}) has ended" in control(hardware, number, "cancel").message


def test_a_command_that_is_cancelled_is_not_paused(machine, client, wait_until):
    hardware, steps = machine[1], []
    goals = len(hardware.goals)
    handle = execute(client[0], "move", '{"speed": 0.1}', steps)
    wait_until(lambda: len(hardware.goals) > goals, "the goal")
    hardware.refusals = 1_000_000  # it goes on until it is let go
    number = steps[0].command_id
    assert control(hardware, number, "cancel").success
    for request in ("pause", "resume"):
        assert control(hardware, number, request).message == f"move is cancelling: there is nothing to {request}"
    hardware.refusals = 0
    assert completed(handle.get_result_async()).result.status.code == "cancelled"


def test_a_pause_does_not_hold_up_a_command_that_is_being_cancelled(machine, client, wait_until):
    (node, hardware, _, _), steps = machine, []
    goals = len(hardware.goals)
    handle = execute(client[0], "move", '{"speed": 0.1}', steps)
    wait_until(lambda: len(hardware.goals) > goals, "the goal")
    number = steps[0].command_id

    def both():
        node.commands.cancel(number)
        node.commands.hold(number, True)

    in_loop(node, both)
    assert completed(handle.get_result_async()).result.status.code == "cancelled"
    wait_until(lambda: not node.exchange.nets["worker"].rule.held, "nothing to be held any more")


@pytest.mark.parametrize(
    ("goal", "sentence"),
    [
        ({"attach": True}, "to attach needs the number or the symbol of a command"),
        ({"attach": True, "symbol": "mvoe"}, "no command 'mvoe'; did you mean 'move'"),
        ({"attach": True, "symbol": "switch", "command_id": 4_000_000}, "no command has the number 4000000"),
        ({"symbol": "switch", "command_id": 7}, "command_id 7 is that of a command to attach to; say attach"),
        ({"symbol": "swich"}, "no command 'swich'; did you mean 'switch'"),
        ({"symbol": "switch", "arguments": '["on"]'}, "the JSON object of the command's arguments"),
        ({"symbol": "switch", "arguments": '{"on": true}', "priority": 11}, "priority 11 is not between -10 and 10"),
    ],
)
def test_a_goal_that_is_none_is_refused_in_a_sentence(client, goal, sentence):
    handle = completed(client[0].send_goal_async(ExecuteCommand.Goal(**goal)))
    assert sentence in completed(handle.get_result_async()).result.status.message


def test_to_attach_to_a_number_is_not_to_attach_to_another_command(client):
    steps = []
    completed(execute(client[0], "switch", '{"on": true}', steps).get_result_async())
    wrong = ExecuteCommand.Goal(attach=True, symbol="move", command_id=steps[0].command_id)
    result = completed(completed(client[0].send_goal_async(wrong)).get_result_async()).result
    assert result.status.message == f"number {steps[0].command_id} is switch, not move"


def call(hardware, kind, name, **fields):
    found = hardware.create_client(kind, f"/worker/{name}")
    try:
        return call_blocking(found, kind.Request(**fields), 60.0, name)
    finally:
        hardware.destroy_client(found)


def control(hardware, number, request):
    return call(hardware, ControlCommand, "control_command", command_id=number, request=request)


def test_a_command_whose_arguments_are_no_json_is_refused_with_the_reason(client):
    answer = completed(execute(client[0], "switch", "on", []).get_result_async())
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert "the JSON object of the command's arguments" in answer.result.status.message


def test_the_commands_of_a_node_are_listed(machine, client, wait_until):
    wait_until(lambda: client[1], "the list of commands")
    commands = json.loads(client[1][-1])["commands"]
    assert {"symbol": "switch", "net": "worker", "description": ""} in commands
    assert [each["symbol"] for each in commands] == list(machine[0].exchange.nets["worker"].net.symbols())


def test_an_unknown_command_is_refused_by_name(machine):
    refused = []

    async def work():
        try:
            await machine[0].commands.run("mov")
        except Exception as error:
            refused.append(str(error))

    machine[0].executor.create_task(work())
    machine[0].wake()
    deadline = clock.monotonic() + 60.0
    while not refused and clock.monotonic() < deadline:
        clock.sleep(0.02)
    assert "there is no command 'mov'; did you mean 'move'?" in refused[0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: [a, b]}}", "place b can grow without end"),
        ("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}}", "stuck with b=1"),
        (
            "net: n\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a, symbol: s, action: f, on_failure: a}}",
            "no action function 'f' is registered",
        ),
        (
            "net: n\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a, symbol: s, on_failure: a, "
            "service: {name: /x, type: std_srvs/srv/Triger}}}",
            "did you mean 'Trigger'",
        ),
        (
            "net: n\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a, symbol: s, on_failure: a, "
            "goal: {name: /x, type: lab_msgs/action/Weigh}}}",
            "transitions.t.goal.type: there is no package with action types 'lab_msgs'; types are those of "
            "packages whose install/setup.bash was sourced before the start",
        ),
    ],
)
def test_a_node_refuses_a_net_at_load_and_says_why(machine, tmp_path, text, reason):
    file = tmp_path / "n.yaml"
    file.write_text(text)
    alone = [Parameter("standalone", value=True)]
    node = PntNode("refusing", [file], verifier=verify_to_load, parameter_overrides=alone)
    with spin_in_thread(node):
        deadline = clock.monotonic() + 60.0
        while not node.failed and clock.monotonic() < deadline:
            clock.sleep(0.02)
        assert reason in node.failed
