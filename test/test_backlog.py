"""No answer is lost where a node begins to listen, of which the middleware tells nobody, or where its loop is late."""

import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedActionClient, GuardedActionServer
from im_core.ros.node import ManagedNode
from im_msgs.action import ExecuteCommand

SUPPORT = Path(__file__).parent / "support"


@pytest.fixture(scope="module")
def held_up(tmp_path_factory):
    """The environment of a process that is held up while it begins to listen, once it says for how long."""
    library = tmp_path_factory.mktemp("late") / "late_listener.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, SUPPORT / "late_listener.c", "-ldl"], check=True)
    fastdds = re.search(r"\S*/libfastrtps\.so\S*", Path("/proc/self/maps").read_text())
    return {"LD_PRELOAD": str(library), "LATE_LIBRARY": fastdds[0], "LATE_US": "0"}


@pytest.fixture
def early(ros):
    """A node that has long been there: it publishes once, answers requests, and accepts goals."""

    async def done(goal):
        goal.succeed()
        return ExecuteCommand.Result(success=True)

    def answered(request, response):
        response.message = "answered"
        return response

    node = ros(ManagedNode("early"))
    node.create_publisher(String, "/early/said", qos.LATCHED).publish(String(data="said once"))
    node.create_service(Trigger, "/early/asked", answered)
    node.server = GuardedActionServer(node, ExecuteCommand, "/early/execute", done)
    return node


def heard(late):
    late.wait(120.0)
    return late.out.read_text()


@pytest.mark.parametrize(
    ("role", "comes"), [("subscription", "said once"), ("client", "answered"), ("action_client", "accepted: True")]
)
def test_what_comes_while_a_node_begins_to_listen_is_heard(early, process, held_up, role, comes):
    late = process(sys.executable, SUPPORT / "late_node.py", role, **held_up)
    assert heard(late) == f"{comes}\n"


def test_rmw_still_misses_what_comes_while_a_reader_is_new(early, process, held_up):
    """Once this fails, im_core/ros/rclpy_fixes/backlog.py may go."""
    assert heard(process(sys.executable, SUPPORT / "late_node.py", "bare", **held_up)) == ""


def test_a_request_that_comes_while_a_node_begins_to_listen_is_answered(early, process, held_up, wait_until):
    late = process(sys.executable, SUPPORT / "late_node.py", "service", **held_up)
    client = early.create_client(Trigger, "/late/asked")
    wait_until(client.service_is_ready, "the service")
    answer = client.call_async(Trigger.Request())
    assert heard(late) == "asked\n"
    wait_until(answer.done, "the answer")
    assert answer.result().message == "answered"


def test_a_goal_that_comes_while_a_node_begins_to_listen_is_carried_out(early, process, held_up, wait_until):
    late = process(sys.executable, SUPPORT / "late_node.py", "action_server", **held_up)
    client = GuardedActionClient(early, ExecuteCommand, "/late/execute")
    wait_until(client.server_is_ready, "the action")
    asked = client.send_goal_async(ExecuteCommand.Goal())
    assert heard(late) == "asked\n"
    wait_until(asked.done, "the goal to be accepted")
    assert asked.result().accepted


class Slow(ManagedNode):
    """A node whose loop waits until it may go on."""

    def __init__(self):
        super().__init__("slow")
        self.held_up, self.may_go_on = threading.Event(), threading.Event()

    def hold_up(self):
        self.held_up.set()
        assert self.may_go_on.wait(60.0), "it was held up for ever"


def test_answers_to_others_push_out_none_of_a_client_whose_loop_is_late(early, ros, wait_until):
    slow, other = ros(Slow()), ros(ManagedNode("other"))
    its_client, others_client = (node.create_client(Trigger, "/early/asked") for node in (slow, other))
    wait_until(lambda: its_client.service_is_ready() and others_client.service_is_ready(), "the service")
    slow.executor.create_task(slow.hold_up)
    assert slow.held_up.wait(60.0)
    answer = its_client.call_async(Trigger.Request())
    for _ in range(50):
        call_blocking(others_client, Trigger.Request(), 60.0, "an answer to another")
    slow.may_go_on.set()
    wait_until(answer.done, "the answer")


def test_goals_of_others_push_out_no_answer_to_a_client_whose_loop_is_late(early, ros, wait_until):
    slow, other = ros(Slow()), ros(ManagedNode("other"))
    its_client, others = (GuardedActionClient(node, ExecuteCommand, "/early/execute") for node in (slow, other))
    wait_until(lambda: its_client.server_is_ready() and others.server_is_ready(), "the action")
    slow.executor.create_task(slow.hold_up)
    assert slow.held_up.wait(60.0)
    accepted = its_client.send_goal_async(ExecuteCommand.Goal())
    for _ in range(50):
        asked = others.send_goal_async(ExecuteCommand.Goal())
        wait_until(asked.done, "another's goal to be accepted")
    slow.may_go_on.set()
    wait_until(accepted.done, "the goal to be accepted")
