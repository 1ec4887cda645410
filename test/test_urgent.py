"""Stops are taken before work that waits: cancel, pause and urgent services with 10,000 messages behind."""

import threading

import pytest
from action_msgs.srv import CancelGoal
from rclpy.action import CancelResponse
from rclpy.qos import QoSProfile
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from im_core import clock
from im_core.ros import urgent
from im_core.ros.guard import GuardedActionClient, GuardedActionServer, GuardedNode
from im_core.ros.node import ManagedNode
from im_msgs.action import ExecuteCommand

MANY = 10_000
PATIENCE_S = 60.0
TOPICS = [f"/busy/work_{number}" for number in range(4)]
QUEUE = QoSProfile(depth=MANY // len(TOPICS))  # of one reader Fast DDS keeps 5,000


class Busy(ManagedNode):
    """Is held at the first message, with the others behind; notes how many messages were taken when a stop was."""

    def __init__(self):
        super().__init__("busy")
        self.stops, self.taken = [], 0
        self.held, self.go = threading.Event(), threading.Event()
        for topic in TOPICS:
            self.create_subscription(Int32, topic, self._work, QUEUE)
        self.create_service(Trigger, "/busy/stop", self._stop, urgent=True)
        self.server = GuardedActionServer(
            self, ExecuteCommand, "/busy/execute", self._execute, cancel_callback=self._cancel
        )

    def _work(self, _):
        self.taken += 1
        if not self.go.is_set():
            self.held.set()
            assert self.go.wait(PATIENCE_S)
        elif not self.stops and self.taken < MANY / 2:
            clock.sleep(0.001)  # of a slow computer the stop is still on its way

    def _stop(self, _, response):
        self.stops.append(self.taken)
        response.success = True
        return response

    def _cancel(self, _):
        self.stops.append(self.taken)
        return CancelResponse.ACCEPT

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
    node.work = [node.create_publisher(Int32, topic, QUEUE) for topic in TOPICS]
    node.stop = node.create_client(Trigger, "/busy/stop")
    node.action = GuardedActionClient(node, ExecuteCommand, "/busy/execute")
    node.cancel_all = node.create_client(CancelGoal, "/busy/execute/_action/cancel_goal")
    return node


@pytest.fixture
def busy(ros, asker, wait_until, monkeypatch):
    """The node, and clients that have found it."""
    monkeypatch.setattr(urgent, "LOOK_S", 0.0)
    node = ros(Busy())
    yield node
    node.go.set()


def fill(asker, busy):
    for _ in range(MANY // len(TOPICS)):
        for publisher in asker.work:
            publisher.publish(Int32())
    assert busy.held.wait(PATIENCE_S)


def found(asker, wait_until):
    wait_until(lambda: all(each.get_subscription_count() for each in asker.work), "the subscriptions", PATIENCE_S)
    assert asker.stop.wait_for_service(PATIENCE_S)
    assert asker.action.wait_for_server(PATIENCE_S)
    assert asker.cancel_all.wait_for_service(PATIENCE_S)


def taken_early(busy, wait_until):
    busy.go.set()
    wait_until(lambda: busy.taken == MANY, "all messages", PATIENCE_S)
    assert busy.stops
    assert max(busy.stops) < MANY / 2


def test_a_stop_is_taken_before_ten_thousand_messages(busy, asker, wait_until):
    found(asker, wait_until)
    fill(asker, busy)
    answer = asker.stop.call_async(Trigger.Request())
    taken_early(busy, wait_until)
    assert answer.result().success


def test_a_cancellation_is_taken_before_ten_thousand_messages(busy, asker, wait_until):
    found(asker, wait_until)
    accepted = asker.action.send_goal_async(ExecuteCommand.Goal(symbol="long"))
    wait_until(accepted.done, "the goal to be accepted")
    fill(asker, busy)
    answer = accepted.result().cancel_goal_async()
    taken_early(busy, wait_until)
    wait_until(answer.done, "the answer to the cancellation")
    assert len(answer.result().goals_canceling) == 1


def test_a_cancellation_of_all_goals_includes_those_that_wait(busy, asker, wait_until):
    found(asker, wait_until)
    fill(asker, busy)
    goals = [asker.action.send_goal_async(ExecuteCommand.Goal(symbol="late")) for _ in range(3)]
    answer = asker.cancel_all.call_async(CancelGoal.Request())
    taken_early(busy, wait_until)
    wait_until(lambda: answer.done() and all(goal.done() for goal in goals), "the answers")
    assert len(answer.result().goals_canceling) == 3


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
    assert readers._takes == []
