"""A program of somebody else: plain rclpy, nothing of this workspace."""

import queue
import threading

from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from im_core import clock

PATIENCE_S = 600.0


class Stranger(Node):
    """A node that knows nothing of this workspace, and a thread that spins it."""

    def __init__(self):
        super().__init__("stranger")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._actions = {}
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def end(self):
        self._executor.shutdown()
        self._thread.join()
        for action in self._actions.values():
            action.destroy()
        self.destroy_node()

    @staticmethod
    def wait(future):
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(PATIENCE_S), "no answer"
        return future.result()

    def call(self, kind, name, **fields):
        service = self.create_client(kind, name)
        assert service.wait_for_service(PATIENCE_S), name
        answer = self.wait(service.call_async(kind.Request(**fields)))
        self.destroy_client(service)
        return answer

    def send(self, kind, name, goal, feedback=None):
        """Send a goal; its handle."""
        if name not in self._actions:
            self._actions[name] = ActionClient(self, kind, name)
            assert self._actions[name].wait_for_server(PATIENCE_S), name
            clock.sleep(0.5)  # the server must have discovered the client, too
        return self.ask(lambda: self._actions[name].send_goal_async(goal, feedback_callback=feedback))

    def ask(self, question):
        """The answer to a question asked in the loop: rclpy drops one that comes before the question is noted."""
        asked = queue.SimpleQueue()
        self._executor.create_task(lambda: asked.put(question()))
        return self.wait(asked.get(timeout=PATIENCE_S))
