"""Node of a command: spins while the command waits; a signal ends the wait."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import rclpy
from rclpy.client import Client

from im import UnreachableError
from im_bringup.machine.machine_state import runs_here
from im_bringup.ros.client_output import LOOKED_FOR_S, NOT_RUNNING, exit_code, own_output
from im_core import clock
from im_core.errors import WaitTimeoutError
from im_core.output import complain
from im_core.processes.end_signals import heed_end_signals
from im_core.ros.guard import GuardedNode
from im_core.ros.run import Spinner, begin_ros

_POLL_S = 0.02

BOOTSTRAP = "bootstrap"
"""Name of the node that each machine has."""


class InterruptibleNode(GuardedNode):
    """Node able to wait for others until an interruption.

    Args:
        name: Begins its name, which has the number of the process, too.
    """

    def __init__(self, name: str) -> None:
        super().__init__(f"{name}_{os.getpid()}")
        self._interrupted = threading.Event()

    def interrupt(self) -> None:
        """Stop waiting; from any thread."""
        self._interrupted.set()

    def ask(self, client: Client, request: object, timeout_s: float) -> Any:
        """The answer of a service.

        Args:
            client: Of the service, made by this node.
            request: What is asked.
            timeout_s: Longest wait for the service to be found, and for its answer [s].

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            WaitTimeoutError: It is not there, or does not answer.
        """
        self._until(client.service_is_ready, f"the service {client.srv_name}", timeout_s)
        future = client.call_async(request)
        try:
            self._until(future.done, f"an answer of {client.srv_name}", timeout_s)
        except WaitTimeoutError:
            client.remove_pending_request(future)
            raise
        return future.result()

    def pause(self, seconds: float) -> None:
        """Let time pass.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
        """
        if self._interrupted.wait(seconds):
            raise KeyboardInterrupt

    def require_machine(self) -> None:
        """Wait for a machine, known to the local host or seen in the graph.

        Raises:
            DataError: What this host knows of it cannot be read.
            KeyboardInterrupt: :meth:`interrupt` was called.
            UnreachableError: There is none.
        """
        try:
            self._until(lambda: runs_here() or BOOTSTRAP in self.get_node_names(), "a machine", LOOKED_FOR_S)
        except WaitTimeoutError as error:
            raise UnreachableError.of_no_machine(self.context.get_domain_id(), LOOKED_FOR_S) from error

    def _until(self, ready: Callable[[], bool], what: str, seconds: float) -> None:
        """Wait until something is so.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            WaitTimeoutError: It is not in time, and is not worth waiting for any longer.
        """
        deadline = clock.monotonic() + seconds
        while not ready():
            self.pause(_POLL_S)
            if clock.monotonic() > deadline and not self._may_yet_come():
                raise WaitTimeoutError(what=what, seconds=seconds)

    def _may_yet_come(self) -> bool:
        """Check whether a late answer is still worth waiting for."""
        return False


NodeT = TypeVar("NodeT", bound=InterruptibleNode)


@contextlib.contextmanager
def spun(make: Callable[[], NodeT]) -> Iterator[NodeT]:
    """Initialise ROS for the block, and spin a node; end signals interrupt the block."""
    with own_output():
        begin_ros([])
        try:
            node = make()
            heed_end_signals(lambda _: node.interrupt())
            with Spinner([node]):
                yield node
        finally:
            rclpy.try_shutdown()


def talk(make: Callable[[], NodeT], use: Callable[[NodeT], int], who: str) -> int:
    """Run a client of a machine on any host; print the reason of a failure in one sentence; return the exit code.

    Args:
        make: Makes the client, once ROS is there.
        use: Does it, while the client spins; returns the exit code.
        who: Name of the program, for messages.
    """

    def spin() -> int:
        with spun(make) as client:
            try:
                client.require_machine()
            except UnreachableError as error:
                complain(f"{who}: {error.message}")
                return NOT_RUNNING
            return use(client)

    return exit_code(spin, who)
