"""Running of nodes with the events executor: the one place to spin."""

import argparse
import contextlib
import faulthandler
import inspect
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, TypeVar, cast
from weakref import WeakSet

import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future, Task
from rclpy.utilities import remove_ros_args

from im_core.errors import ImError, StateError
from im_core.processes import scheduling
from im_core.processes.agent_socket import AgentOrder, AgentSocket
from im_core.processes.end_signals import heed_end_signals
from im_core.processes.loop_heartbeat import Pulse
from im_core.processes.loop_watch import LoopWatch
from im_core.ros.guard import GuardedNode
from im_core.ros.node import ManagedNode
from im_core.ros.rclpy_fixes.backlog import new_readers, take_backlog
from im_core.ros.rclpy_fixes.bounded_end import bounded_end
from im_core.ros.rclpy_fixes.one_reader import shared_readers

# Without a time-out the events executor busy-loops; this one is never reached.
FOREVER_S = 1e6

NodeT = TypeVar("NodeT", bound=rclpy.node.Node)


@dataclass(frozen=True)
class Program:
    """Work of a process with one node; arguments as of :func:`main`."""

    make_node: Callable[[], rclpy.node.Node]
    at_end: Callable[[Any], None] | None = None


_gathered: ContextVar[list[Program] | None] = ContextVar("gathered", default=None)


class GuardedExecutor(rclpy_implementation.EventsExecutor):  # type: ignore[misc]  # of C++: it has no types
    """Events executor, fixed: arrivals before the listening are heard, and a raising task ends nothing.

    A task that raised would end its process by a segmentation fault; for the rest see
    :mod:`im_core.ros.rclpy_fixes.backlog`.
    """

    def __init__(self, context: rclpy.Context, note: Callable[[Exception], None]) -> None:
        rclpy_implementation.EventsExecutor.__init__(self, context)
        self._note = note
        self._listened: WeakSet[Any] = WeakSet()

    def add_node(self, node: rclpy.node.Node) -> bool:
        """As in rclpy."""
        added: bool = rclpy_implementation.EventsExecutor.add_node(self, node)
        if added:
            self._look_into_new_readers()
        return added

    def wake(self) -> None:
        """Look at the present contents of the nodes, as in rclpy; from any thread."""
        rclpy_implementation.EventsExecutor.wake(self)
        self._look_into_new_readers()

    def _look_into_new_readers(self) -> None:
        """Queue a check of each new reader, run after the executor has begun to listen to the reader."""
        for node in self.get_nodes():
            for reader in new_readers(node, self._listened):
                self.create_task(take_backlog, reader, self)

    def create_task(self, callback: Any, *args: Any, **options: Any) -> Task:
        """Create a task as in rclpy; the result of a task with an exception is None."""

        async def guarded() -> Any:
            try:
                result = callback if inspect.iscoroutine(callback) else callback(*args, **options)
                return await result if inspect.iscoroutine(result) else result
            except Exception as error:  # noted
                self._note(error)

        task: Task = rclpy_implementation.EventsExecutor.create_task(self, guarded())
        return task


class Spinner:
    """Nodes of one context in one events executor, in the present thread or an own one; the last node ends first."""

    def __init__(self, nodes: Sequence[rclpy.node.Node]) -> None:
        self.nodes = list(nodes)
        if not faulthandler.is_enabled():
            faulthandler.enable()  # a fault in C leaves the stack of all threads, too
        self.executor: Any = GuardedExecutor(self.nodes[0].context, self._note)
        self.nodes[0].context.on_shutdown(self.executor.wake)
        self._share_urgent()
        for node in self.nodes:
            self.executor.add_node(node)
        self._end = Future()
        self._thread: threading.Thread | None = None

    def spin(self) -> None:
        """Spin until :meth:`stop` or the shutdown of ROS; an exception leaving the executor is only noted."""
        context = self.nodes[0].context
        while not self._end.done() and context.ok():
            try:
                self.executor.spin_until_future_complete(self._end, FOREVER_S)
            except (KeyboardInterrupt, ExternalShutdownException):
                return
            except Exception as error:  # callbacks and tasks are guarded; this is what rclpy itself raised
                if not context.ok():
                    return
                self._note(error)

    def _share_urgent(self) -> None:
        """Have each node look into the urgent readers of all: the nodes wait for one loop."""
        guarded = [node for node in self.nodes if isinstance(node, GuardedNode)]
        for node in guarded[1:]:
            guarded[0].urgent.join(node.urgent)
            node.urgent = guarded[0].urgent

    def _note(self, error: Exception) -> None:
        guarded = next((node for node in self.nodes if isinstance(node, GuardedNode)), None)
        if guarded is None:
            self.nodes[0].get_logger().error(f"the loop goes on after {error!r}")
        else:
            guarded.note_failure("the executor", error)

    def start(self) -> "Spinner":
        """Spin in a thread; harmless if already spinning."""
        if self._thread is None:
            self._thread = threading.Thread(target=self.spin, name="spinner", daemon=True)
            self._thread.start()
        return self

    def request_stop(self) -> None:
        """End :meth:`spin` soon; from any thread."""
        if not self._end.done():
            self._end.set_result(None)
        self.executor.wake()

    def stop(self) -> None:
        """End the spinning and destroy the nodes."""
        self.request_stop()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        for node in reversed(self.nodes):
            if isinstance(node, ManagedNode):
                node.shut_down_once()
        self.executor.shutdown(1.0)
        for node in reversed(self.nodes):
            _destroy(node)

    def __enter__(self) -> "Spinner":
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()


def _destroy(node: rclpy.node.Node) -> None:
    """Destroy a node, actions first: rclpy leaves actions and the participant in the graph for ever.

    Servers of which a peer hears only a part keep its clients from finding those that are there.
    """
    for waitable in tuple(node.waitables):
        if isinstance(waitable, ActionClient | ActionServer):
            cast(Any, waitable).destroy()  # rclpy says no types
    with bounded_end(), contextlib.suppress(InvalidHandle, rclpy_implementation.RCLError):
        node.destroy_node()


def spin_in_thread(*nodes: rclpy.node.Node) -> Spinner:
    """Spin nodes in a thread; stop with :meth:`Spinner.stop`, or use a ``with`` statement."""
    return Spinner(nodes).start()


def main(
    make_node: Callable[[], NodeT], args: Sequence[str] | None = None, at_end: Callable[[NodeT], None] | None = None
) -> int:
    """Run one node as a process until an end signal or SHUTDOWN; within :func:`gathered`, only add the node.

    Args:
        make_node: Makes the node, after ROS is initialised.
        args: Arguments for ROS; None: those of the process, which may ask for help.
        at_end: Called with the node when the spinning has ended, before the node is destroyed.

    Returns:
        Exit code: 0 after an orderly end, 1 if the node could not be made.
    """
    program, gathering = Program(make_node, at_end), _gathered.get()
    if gathering is not None:
        gathering.append(program)
        return 0
    if args is None:
        _parser(make_node).parse_args(remove_ros_args(sys.argv)[1:])
    return run_together([program], args)


def begin_ros(args: Sequence[str] | None = None) -> None:
    """Initialise ROS without signal handlers.

    Args:
        args: Arguments for ROS; None: those of the process.

    Raises:
        StateError: ROS refuses, as where the folder of its logs cannot be written.
    """
    try:
        rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # of rcl, too
        raise StateError(f"ROS does not begin: {str(error).splitlines()[0]}") from error


@contextlib.contextmanager
def gathered() -> Iterator[list[Program]]:
    """Collect programs in a list for :func:`run_together`: within the context, :func:`main` runs nothing."""
    programs: list[Program] = []
    token = _gathered.set(programs)
    try:
        yield programs
    finally:
        _gathered.reset(token)


def run_together(programs: Sequence[Program], args: Sequence[str] | None = None) -> int:
    """Run the nodes of several programs in one process: one interpreter, one DDS participant, one executor.

    They are made in this order and end in the reverse one. A callback that blocks holds up all of them.

    Args:
        programs: The programs.
        args: Arguments for ROS; None: those of the process.

    Returns:
        Exit code, as of :func:`main`.
    """
    scheduling.keep_off()
    agent = AgentSocket.inherited()
    try:
        begin_ros(args)
        with shared_readers():
            nodes = [program.make_node() for program in programs]
    except ImError as error:
        print(error.message, file=sys.stderr)
        rclpy.try_shutdown()
        return 1
    spinner = Spinner(nodes)
    heed_end_signals(lambda _: spinner.request_stop())
    _serve(agent, [node for node in nodes if isinstance(node, ManagedNode)])
    watch = _watch(spinner, Pulse.inherited())
    try:
        spinner.spin()
    finally:
        if watch is not None:
            watch.stop()
        for program, node in reversed(list(zip(programs, nodes, strict=True))):
            if program.at_end is not None:
                program.at_end(node)
        spinner.stop()
        rclpy.try_shutdown()
    return 0


def _serve(agent: AgentSocket | None, nodes: Sequence[ManagedNode]) -> None:
    """Have the nodes follow the orders of the agent of the process, if there is one."""
    if agent is None:
        for node in nodes:
            if not node.get_parameter("standalone").value:
                node.get_logger().warning("no agent has started this process, and it waits for one: standalone:=true")
        return

    async def obey(node: ManagedNode, order: AgentOrder) -> None:
        node.obey(order)

    def listen() -> None:
        for order in agent.orders():
            for node in nodes:
                node.spawn(obey(node, order))

    for node in nodes:
        node.serve(agent)
    threading.Thread(target=listen, name="orders", daemon=True).start()


def _watch(spinner: Spinner, pulse: Pulse | None) -> LoopWatch | None:
    """Begin to report the state of the loop to the agent of the process, if any.

    The loop may stand still for as long as the most patient of its nodes allows now.
    """
    guarded = [node for node in spinner.nodes if isinstance(node, GuardedNode)]
    if pulse is None or not guarded:
        return None
    watch = LoopWatch(
        pulse,
        turns=lambda: sum(node.turns for node in guarded),
        nudge=lambda: spinner.executor.create_task(guarded[0].turn),
        allowed_s=lambda: max(node.standstill_s for node in guarded),
    )
    watch.start()
    return watch


def _parser(make_node: Callable[[], NodeT]) -> argparse.ArgumentParser:
    """Build the argument parser of a node: no own arguments, the arguments of ROS, and help."""
    return argparse.ArgumentParser(
        usage="%(prog)s [-h] [--ros-args -p NAME:=VALUE ... --params-file FILE --log-level LEVEL]",
        description=sys.modules[make_node.__module__].__doc__,
        epilog="A running node tells its parameters: /NODE/list_parameters and /NODE/describe_parameters.",
    )
