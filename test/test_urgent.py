"""Stops are taken before work that waits: cancel, pause and urgent services with 10,000 messages behind."""

import pytest
import rclpy
from action_msgs.srv import CancelGoal
from rclpy.action import CancelResponse
from std_srvs.srv import Trigger

from im_coordinators.ros.gripper import GripperCoordinator
from im_core import clock
from im_core.ros import urgent
from im_core.ros.calls import run_in_thread
from im_core.ros.guard import GuardedActionClient, GuardedActionServer, GuardedNode
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_dispatcher.ros.node import Dispatcher
from im_msgs.action import ExecuteCommand
from im_msgs.srv import ControlCommand, ControlNet
from support.flood import PATIENCE_S, Flood


class Busy(ManagedNode):
    """Has a service that stops it, and an action that lasts until it is cancelled."""

    def __init__(self):
        super().__init__("busy")
        self.create_service(Trigger, "/busy/stop", self._stop, urgent=True)
        self.create_service(Trigger, "/busy/stop_on_file", self._stop_on_file, urgent=True)
        self.server = GuardedActionServer(
            self, ExecuteCommand, "/busy/execute", self._execute, cancel_callback=lambda _: CancelResponse.ACCEPT
        )

    def _stop(self, _, response):
        response.success = True
        return response

    async def _stop_on_file(self, _, response):
        await run_in_thread(self, clock.sleep, 0.05)
        response.success = True
        return response

    async def _execute(self, goal):
        while not goal.is_cancel_requested:
            turn = self.promise()
            self.alarms.after(0.01, lambda turn=turn: turn.set_result(None))
            await turn
        goal.canceled()
        return ExecuteCommand.Result()


@pytest.fixture
def asker(ros):
    node = ros(GuardedNode("asker"))
    node.stop = node.create_client(Trigger, "/busy/stop")
    node.stop_on_file = node.create_client(Trigger, "/busy/stop_on_file")
    node.action = GuardedActionClient(node, ExecuteCommand, "/busy/execute")
    node.cancel_all = node.create_client(CancelGoal, "/busy/execute/_action/cancel_goal")
    return node


@pytest.fixture
def flood(ros, asker, monkeypatch):
    """Work for the node; clients have found it."""
    monkeypatch.setattr(urgent, "LOOK_S", 0.0)
    node = ros(Busy())
    assert asker.stop.wait_for_service(PATIENCE_S)
    assert asker.stop_on_file.wait_for_service(PATIENCE_S)
    assert asker.action.wait_for_server(PATIENCE_S)
    assert asker.cancel_all.wait_for_service(PATIENCE_S)
    flood = Flood(node, asker)
    yield flood
    flood.end()


def test_a_stop_is_taken_before_ten_thousand_messages(flood, asker, wait_until):
    flood.fill(wait_until)
    answer = asker.stop.call_async(Trigger.Request())
    answer.add_done_callback(flood.stopped)
    flood.let_go(wait_until)
    assert answer.result().success


def test_the_answer_to_a_stop_that_waits_for_a_disk_comes_before_ten_thousand_messages(flood, asker, wait_until):
    flood.fill(wait_until)
    answer = asker.stop_on_file.call_async(Trigger.Request())
    answer.add_done_callback(flood.stopped)
    flood.let_go(wait_until)
    assert answer.result().success


def test_a_cancellation_is_taken_before_ten_thousand_messages(flood, asker, wait_until):
    accepted = asker.action.send_goal_async(ExecuteCommand.Goal(symbol="long"))
    wait_until(accepted.done, "the goal to be accepted")
    flood.fill(wait_until)
    answer = accepted.result().cancel_goal_async()
    answer.add_done_callback(flood.stopped)
    flood.let_go(wait_until)
    wait_until(answer.done, "the answer to the cancellation")
    assert len(answer.result().goals_canceling) == 1


def test_a_cancellation_of_all_goals_includes_those_that_wait(flood, asker, wait_until):
    flood.fill(wait_until)
    goals = [asker.action.send_goal_async(ExecuteCommand.Goal(symbol="late")) for _ in range(3)]
    answer = asker.cancel_all.call_async(CancelGoal.Request())
    answer.add_done_callback(flood.stopped)
    flood.let_go(wait_until)
    wait_until(lambda: answer.done() and all(goal.done() for goal in goals), "the answers")
    assert len(answer.result().goals_canceling) == 3


@pytest.mark.parametrize("task", [Dispatcher, GripperCoordinator])
def test_a_task_with_nets_is_paused_and_its_commands_before_ten_thousand_messages(task, wait_until):
    rclpy.init(args=["--ros-args", "-p", "standalone:=true", "-p", "commands:=demo"])  # the others ask /dom first
    node, asker = task(), GuardedNode("asker")
    try:
        with spin_in_thread(node), spin_in_thread(asker):
            wait_until(lambda: node.ready or node.failed, "the task", PATIENCE_S)
            assert not node.failed
            requests = [(ControlNet.Request(net=next(iter(node.exchange.nets)), request="pause"), "control_net")]
            if task is Dispatcher:
                requests.append((ControlCommand.Request(command_id=1, request="cancel"), "control_command"))
            clients = [
                asker.create_client(
                    ControlNet if name == "control_net" else ControlCommand, f"/{node.task_name}/{name}"
                )
                for each, name in requests
            ]
            assert all(client.wait_for_service(PATIENCE_S) for client in clients)
            flood = Flood(node, asker)
            flood.fill(wait_until)
            answers = [client.call_async(request) for client, (request, _) in zip(clients, requests, strict=True)]
            flood.let_go(wait_until, lambda: all(answer.done() for answer in answers))
            assert answers[0].result().success, answers[0].result().message
            assert all("no command has the number 1" in answer.result().message for answer in answers[1:])
    finally:
        rclpy.try_shutdown()


def test_nodes_of_one_loop_look_for_the_stops_of_each_other(ros):
    first, second = GuardedNode("first"), GuardedNode("second")
    ros(first, second)
    assert first.urgent is second.urgent


def test_a_service_that_was_destroyed_is_forgotten(ros, monkeypatch):
    monkeypatch.setattr(urgent, "LOOK_S", 0.0)
    node = ros(ManagedNode("short"))
    service = node.create_service(Trigger, "/short/stop", lambda _, response: response, urgent=True)
    node.destroy_service(service)
    readers = urgent.UrgentReaders()
    readers.join(node.urgent)
    readers.look()
    readers.look()
    assert readers._takes == [node._coroutines.step]
