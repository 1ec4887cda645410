"""A node that spins in the main thread while requests are answered in another."""

import threading
from collections.abc import Callable, Mapping, Sequence

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import UInt64

from bench.nets.serving import Handler, serve
from im_core.clock import monotonic, sleep
from im_core.errors import WaitTimeoutError
from im_core.ros.run import Spinner

PATIENCE_S = 30.0
POLL_S = 0.01


class RclpySpin:
    """Spins nodes as ``rclpy.spin`` does: with the executor that a program has that asks for none."""

    def __init__(self, nodes: Sequence[Node]) -> None:
        self._executor = SingleThreadedExecutor()
        for node in nodes:
            self._executor.add_node(node)
        self._ended = False

    def request_stop(self) -> None:
        """Has :meth:`spin` return; from any thread."""
        self._ended = True
        self._executor.wake()

    def spin(self) -> None:
        """Spins until the request to stop."""
        while not self._ended:
            self._executor.spin_once()

    def stop(self) -> None:
        """Ends the executor."""
        self._executor.shutdown()


def run(
    make_node: Callable[[], Node],
    handlers: Callable[[Node], Mapping[str, Handler]],
    idle: int = 0,
    *,
    spin: type[Spinner | RclpySpin] = Spinner,
) -> None:
    """Runs a node until there are no more requests.

    Args:
        make_node: Makes the node, after ROS is initialised.
        handlers: What answers requests, in a thread of its own.
        idle: Subscriptions to topics on which nobody publishes.
        spin: What spins the node.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = make_node()
    for number in range(idle):
        node.create_subscription(UInt64, f"/bench/idle_{number}", lambda _: None, 10)
    spinner = spin([node])

    def answer() -> None:
        try:
            serve(handlers(node))
        finally:
            spinner.request_stop()

    threading.Thread(target=answer, daemon=True).start()
    spinner.spin()
    spinner.stop()
    rclpy.try_shutdown()


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Waits, in the thread that answers requests.

    Raises:
        WaitTimeoutError: In vain.
    """
    deadline = monotonic() + PATIENCE_S
    while not condition():
        if monotonic() > deadline:
            raise WaitTimeoutError(what=what, seconds=PATIENCE_S)
        sleep(POLL_S)


def alone(**parameters: object) -> list[Parameter]:
    """Returns the parameters of a node that starts without a bootstrap.

    Args:
        parameters: Further ones.
    """
    return [Parameter(name, value=value) for name, value in {"standalone": True, **parameters}.items()]
