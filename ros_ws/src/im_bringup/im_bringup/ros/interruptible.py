"""Node of a command: spins while the command waits; a signal ends the wait."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, TextIO, TypeVar, cast

import rclpy
from rclpy.client import Client
from rclpy.signals import SignalHandlerOptions

from im import MachineError, UnreachableError
from im_bringup.machine.machine_state import runs_here
from im_core import clock
from im_core.errors import ImError, StoreError, WaitTimeoutError
from im_core.output import complain
from im_core.processes.end_signals import heed_end_signals
from im_core.ros.guard import GuardedNode
from im_core.ros.run import Spinner

_OF_RCLPY = (
    "Warning, the number of timers associated with this clock is large.",
    "Management of this number of timers may be inefficient.",
)

_POLL_S = 0.02

BOOTSTRAP = "bootstrap"
"""Name of the node that each machine has."""
LOOKED_FOR_S = 5.0
"""How long a machine is looked for [s]."""

DONE, FAILED, USAGE, NOT_RUNNING, INTERRUPTED = 0, 1, 2, 3, 130


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


class OwnOutput:
    """Standard output or error of a program, without the rclpy 7.1 warning of each timer beyond eight.

    What cannot be written (a full disk, a reader or a terminal that has gone) ends nothing: the machine is waited for.

    Args:
        stream: Where the rest goes; None: nowhere, it was closed when the program began.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream, self._dropped = stream, False
        self._failure: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, except a warning of rclpy and the separately written end of the warning's line."""
        ends, self._dropped = self._dropped and text == "\n", text in _OF_RCLPY
        if not (ends or self._dropped):
            self._try(lambda stream: stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush the written text out of the process."""
        self._try(lambda stream: stream.flush())

    def check(self) -> None:
        """Raise an error if some text could not be written, except when the reader has gone.

        Raises:
            StoreError: It has not.
        """
        if self._failure is not None and not isinstance(self._failure, BrokenPipeError):
            raise StoreError.of("written", "standard output", self._failure)

    def _try(self, use: Callable[[TextIO], object]) -> None:
        if self._stream is None or self._failure is not None:
            return
        try:
            use(self._stream)
        except OSError as error:
            self._failure = error


@contextlib.contextmanager
def own_output() -> Iterator[None]:
    """Reserve standard output for the program within the context; output of libraries goes to standard error.

    Fast DDS prints its errors, at any time and without being asked.

    Raises:
        StoreError: What the program said could not be written.
    """
    with contextlib.ExitStack() as stack:
        out, given = cast("TextIO | None", sys.stdout), sys.__stdout__
        if given is not None and out is given:  # nobody has put something else in its place
            given.flush()
            number = given.fileno()
            out = os.fdopen(os.dup(number), "w", encoding=given.encoding, errors=given.errors)
            stack.callback(_close, out)
            stack.callback(os.dup2, out.fileno(), number)
            if sys.stderr is not None:
                os.dup2(sys.stderr.fileno(), number)
        own = OwnOutput(out)
        stack.callback(own.flush)
        stack.enter_context(contextlib.redirect_stdout(cast(TextIO, own)))
        stack.enter_context(contextlib.redirect_stderr(cast(TextIO, OwnOutput(sys.stderr))))
        yield
        own.flush()
        own.check()


def _close(stream: TextIO) -> None:
    with contextlib.suppress(OSError):  # it was told already
        stream.close()


@contextlib.contextmanager
def spun(make: Callable[[], NodeT]) -> Iterator[NodeT]:
    """Initialise ROS for the block, and spin a node; end signals interrupt the block.

    Args:
        make: Makes the node.
    """
    with own_output():
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
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


def exit_code(do: Callable[[], int], who: str, goes_on: str = "") -> int:
    """Do the work of a client; print the reason of a failure in one sentence; return the exit code.

    Args:
        do: Does it; returns the exit code.
        who: Name of the program, for messages.
        goes_on: What goes on after an interruption, a sentence's second half.
    """
    try:
        return do()
    except KeyboardInterrupt:
        complain(f"{who}: no longer waiting{goes_on}")
        return INTERRUPTED
    except (ImError, MachineError) as error:
        complain(f"{who}: {error.message}")
        return NOT_RUNNING if isinstance(error, WaitTimeoutError) else FAILED
