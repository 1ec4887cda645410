"""Service calls, action goals and data objects as parts of transitions; nets that are refused at load."""

import threading

import pytest
import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import SetBool

from im_core import clock
from im_core.ros import qos
from im_core.ros.calls import pause
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_msgs.action import Move
from im_msgs.msg import Firing, ObjectChange, Status
from im_msgs.srv import GetObject
from im_pnt.ros.node import PntNode
from im_pnt_analysis import verify_to_load

NET = """
net: worker
places:
  idle: 1
  ready:
  trouble:
  path_valid: {data_object: path, on_invalid: [trouble]}
transitions:
  switch:
    {in: idle, out: ready, symbol: switch, on_failure: trouble,
     service: {name: /hardware/switch, type: std_srvs/srv/SetBool, build: wanted, handle: note}}
  ended: {in: ready, out: idle, emit: [switch_done, slow_done, move_done, shout_done]}
  move:
    {in: idle, out: ready, symbol: move, on_failure: trouble,
     goal: {name: /hardware/move, type: im_msgs/action/Move, build: path}}
  plan: {in: idle, out: path_valid, symbol: plan, action: nothing, on_failure: trouble}
  planned: {in: path_valid, out: idle, guard: not keep, emit: plan_done}
  slow:
    {in: idle, out: ready, symbol: slow, timeout: 0.3, on_failure: trouble,
     service: {name: /hardware/slow, type: std_srvs/srv/SetBool, build: pace}}
  shout:
    {in: idle, out: ready, symbol: shout, on_failure: trouble,
     topic: {name: /hardware/shouts, type: std_msgs/msg/String, message: {data: ho}}}
  absent:
    {in: idle, out: ready, symbol: absent, on_failure: trouble,
     goal: {name: /nowhere/move, type: im_msgs/action/Move}}
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
        self.changes = self.create_publisher(ObjectChange, "/dom/changes", qos.EVENTS)
        self.refusals = 0
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
        response.success = self.valid
        return response

    def _may_cancel(self, goal):
        self.refusals -= 1
        return CancelResponse.REJECT if self.refusals >= 0 else CancelResponse.ACCEPT

    async def _move(self, goal):
        self.goals.append(goal.request)
        if goal.request.speed_scale > 0.5:
            goal.abort()
            return Move.Result(success=False, status=Status(code="limit", message="left_j3: too fast"))
        for _ in range(100):
            if goal.is_cancel_requested:
                goal.canceled()
                return Move.Result()
            await pause(self, 0.02)
        goal.succeed()
        return Move.Result(success=True)


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
        "pace": lambda ctx: {"data": ctx.command.arguments["very"]},
        "nothing": lambda ctx: None,
    }
    guards = {"keep": lambda ctx: keep[0]}
    node = PntNode("worker", [file], functions, guards, verifier=verify_to_load, parameter_overrides=alone)
    with spin_in_thread(hardware, node):
        deadline = clock.monotonic() + 60.0
        while not node.ready and clock.monotonic() < deadline:
            clock.sleep(0.02)
        yield node, hardware, noted, keep
    rclpy.try_shutdown()


def run(node, symbol, cancel_after=None, after=None, **arguments):
    ended, outcome, numbers = threading.Event(), [], []

    async def work():
        outcome.append(await node.command(symbol, arguments, started=numbers.append))
        ended.set()

    node.executor.create_task(work())
    node.wake()
    if after is not None:
        clock.sleep(0.5)
        after()
    if cancel_after is not None:
        while not numbers:
            clock.sleep(0.0001)
        clock.sleep(cancel_after)
        node.cancel(numbers[0])
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


def test_a_service_that_answers_a_little_late_has_answered(machine):
    assert run(machine[0], "slow", very=False).success


def test_a_service_that_does_not_answer_leaves_the_transition_in_doubt(machine):
    node, _, _, _ = machine
    phases = []
    node.create_subscription(Firing, "/pnt/firings", lambda f: phases.append((f.transition, f.phase)), qos.EVENTS)
    outcome = run(node, "slow", very=True)
    assert outcome.status.code == "in_doubt"
    assert "nobody can tell what became of service /hardware/slow of transition slow: waited 0.3" in (
        outcome.status.message
    )
    clock.sleep(0.3)
    assert [phase for transition, phase in phases if transition == "slow"] == [
        Firing.START,
        Firing.DOUBT,
        Firing.FAILED,
    ]


def test_a_message_is_published(machine):
    node, hardware, _, _ = machine
    heard = []
    hardware.create_subscription(String, "/hardware/shouts", lambda message: heard.append(message.data), qos.EVENTS)
    clock.sleep(0.5)
    assert run(node, "shout").success
    clock.sleep(0.3)
    assert heard == ["ho"]


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


def test_an_action_that_is_not_there_is_named(machine, monkeypatch):
    monkeypatch.setattr("im_pnt.ros.actions.DISCOVERY_TIMEOUT_S", 1.0)
    outcome = run(machine[0], "absent")
    assert "the action /nowhere/move is not there" in outcome.status.message


def test_a_data_place_is_marked_only_if_the_object_is_valid_and_unmarked_when_it_is_not_any_more(machine):
    node, hardware, _, keep = machine
    assert run(node, "plan").success
    hardware.valid = False
    assert "data object path is not valid" in run(node, "plan").status.message
    hardware.valid, keep[0] = True, True
    change = ObjectChange()
    change.object.name = "path"
    outcome = run(node, "plan", after=lambda: hardware.changes.publish(change))
    assert "data object path lost its validity" in outcome.status.message


def test_an_unknown_command_is_refused_by_name(machine):
    refused = []

    async def work():
        try:
            await machine[0].command("mov")
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
