"""A node that is held up while it begins to listen (:file:`late_listener.c`), in a process of its own.

Its argument says to what. It prints what it has heard, and ends.
"""

import os
import queue
import sys

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from im_core import clock
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient, GuardedActionServer
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_msgs.action import ExecuteCommand

HELD_UP_S = 1.0
PATIENCE_S = 20.0
BARE_S = 4.0


class Late(ManagedNode):
    """What it has heard is in ``heard``."""

    def __init__(self) -> None:
        super().__init__("late")
        self.heard: queue.Queue[str] = queue.Queue()

    def subscription(self):
        self.create_subscription(String, "/early/said", lambda message: self.heard.put(message.data), qos.LATCHED)

    def client(self):
        client = self.create_client(Trigger, "/early/asked")
        self.until(client.service_is_ready)
        client.call_async(Trigger.Request()).add_done_callback(lambda future: self.heard.put(future.result().message))

    def action_client(self):
        client = GuardedActionClient(self, ExecuteCommand, "/early/execute")
        self.until(client.server_is_ready)
        asked = client.send_goal_async(ExecuteCommand.Goal())
        asked.add_done_callback(lambda future: self.heard.put(f"accepted: {future.result().accepted}"))

    def service(self):
        self.create_service(Trigger, "/late/asked", self._answer)

    def action_server(self):
        self._server = GuardedActionServer(self, ExecuteCommand, "/late/execute", self._carry_out)

    def until(self, condition):
        deadline = clock.monotonic() + PATIENCE_S
        while not condition():
            assert clock.monotonic() < deadline, f"{condition} did not become true"
            clock.sleep(0.001)

    def _answer(self, request, response):
        self.heard.put("asked")
        response.message = "answered"
        return response

    async def _carry_out(self, goal):
        self.heard.put("asked")
        goal.succeed()
        return ExecuteCommand.Result(success=True)


def bare():
    """Listen to a latched topic with rclpy alone, and print the messages."""
    rclpy.init()
    node, executor = Node("late"), EventsExecutor()
    executor.add_node(node)
    executor.spin_once(timeout_sec=0.1)
    os.environ["LATE_US"] = str(round(HELD_UP_S * 1e6))
    node.create_subscription(String, "/early/said", lambda message: print(message.data, flush=True), qos.LATCHED)
    deadline = clock.monotonic() + BARE_S
    while clock.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    rclpy.try_shutdown()


def main():
    rclpy.init(args=["--ros-args", "-p", "standalone:=true"])
    late = Late()
    with spin_in_thread(late):
        late.until(lambda: late.ready)
        os.environ["LATE_US"] = str(round(HELD_UP_S * 1e6))
        late.executor.create_task(getattr(late, sys.argv[1]))
        try:
            print(late.heard.get(timeout=PATIENCE_S))
        except queue.Empty:
            print("heard nothing")
        clock.sleep(0.5)  # its answers leave
    rclpy.try_shutdown()


if __name__ == "__main__":
    bare() if sys.argv[1] == "bare" else main()
