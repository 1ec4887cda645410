"""Base class of the nodes that execute nets: the Dispatcher and the Coordinators."""

import threading
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from im_core.errors import DataError, ImError, NotFoundError
from im_core.ros import qos
from im_core.ros.dom import DomClient
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_core.ros.status import ok_status, to_status
from im_msgs.msg import ObjectChange, Status
from im_pnt.analysis.reachability import Limits
from im_pnt.analysis.verify import Report, verify
from im_pnt.events import CommandCancelled, Firing, GuardsChanged, ObjectInvalidated, Observer, Phase
from im_pnt.exchange import Exchange
from im_pnt.executive import Executive
from im_pnt.functions import Functions, GuardFunction
from im_pnt.jobs import Command, CommandResult, Job
from im_pnt.net import GoalAction, Net, ServiceAction
from im_pnt.netfile import load_net
from im_pnt.ros.actions import RosActions
from im_pnt.ros.publish import PntPublisher
from im_pnt.ros.transport import DdsTransport
from im_pnt.runner import FunctionRunner

HOUSEKEEPING_PERIOD_S = 0.1
PUMP_DELAY_S = 0.0001
LOAD_LIMITS = Limits(states=100_000, seconds=10.0)

ProgressListener = Callable[[str, str, float], None]
"""Is told the transition that fired or reported, a text, and the progress 0..1 (negative: unknown)."""


@dataclass(frozen=True)
class CommandOutcome:
    """How a command ended, as its client is told."""

    success: bool
    status: Status
    results: dict[str, object]


class PntNode(ManagedNode):
    """ROS shell of nets in execution.

    ``dom`` is the client of the Data Object Manager, ``heartbeats`` tells who is alive.

    Args:
        name: Name of the node.
        net_files: Net files to load, verify and run.
        functions: Actions, builders and handlers that the nets name.
        guards: Enabling functions that the nets name.
    """

    def __init__(
        self,
        name: str,
        net_files: Sequence[str | Path] = (),
        functions: Mapping[str, Callable[..., object]] | None = None,
        guards: Mapping[str, GuardFunction] | None = None,
        **kwargs: object,
    ) -> None:
        super().__init__(name, **kwargs)
        self.net_files = [Path(file) for file in net_files]
        self.functions = Functions(functions, guards)
        self.heartbeats = Heartbeats(self)
        self.seed = int(self.declare_parameter("seed", 0).value)
        self._publisher = PntPublisher(self)
        self._observer = _NodeObserver(self)
        self._transport = DdsTransport(self, self._accept, self._take_back)
        self.exchange = Exchange(name, self._transport.epoch, self._transport, self._observer)
        self._ros_actions = RosActions(self, self.functions, self.heartbeats)
        others = {ServiceAction: self._ros_actions.perform_service, GoalAction: self._ros_actions.perform_goal}
        self._runner = FunctionRunner(self.functions, self.exchange, self._spawn, others)
        self.dom = DomClient(self)
        self.create_subscription(ObjectChange, "/dom/changes", self._object_changed, qos.EVENTS)
        self._commands = 0
        self._listeners: dict[int, ProgressListener] = {}
        self._changed: dict[str, Executive] = {}
        self._known_incarnation: dict[str, int] = {}
        self._loop_thread: int | None = None
        self._pumping = False
        self._pump_timer = self.create_timer(PUMP_DELAY_S, self._pump_once, clock=self.steady_clock)
        self._pump_timer.cancel()
        self.create_timer(HOUSEKEEPING_PERIOD_S, self._keep_house, clock=self.steady_clock)

    # For subclasses.

    def phase_configure(self) -> None:
        """Loads and verifies the nets.

        Raises:
            ImError: A net file is wrong, or a net is refused.
        """
        for file in self.net_files:
            self.load_net(load_net(file))

    def phase_start(self) -> None:
        """Begins to fire."""
        for executive in self.exchange.nets.values():
            executive.post(GuardsChanged())

    def phase_shutdown(self) -> None:
        """Ends what is open."""
        error = ImError(f"{self.task_name} is shutting down", code="cancelled")
        for executive in self.exchange.nets.values():
            executive.post(CommandCancelled(None, error))

    def load_net(self, net: Net) -> Report:
        """Verifies a net and takes it into execution, in the place of one of the same name that is not busy.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetFileError: It names a function that is not registered.
            StateError: One of the same name is busy.
        """
        report = verify([net], LOAD_LIMITS)
        report.require_ok()
        executive = Executive(
            net,
            self.functions,
            self._runner,
            self.exchange,
            self._observer,
            seed=self.seed,
            wake=self._wake_pump,
            check_objects=self._check_objects,
        )
        for transition in net.transitions.values():
            if isinstance(transition.action, ServiceAction | GoalAction):
                self._ros_actions.prepare(transition.action)
        self.exchange.add(executive)
        for partner in net.partners() - self.exchange.nets.keys():
            self._transport.prepare(partner)
        self._publisher.description(executive)
        self._publisher.marking(executive)
        self.get_logger().info(f"net {net.name} verified: {report.states} markings in {report.time_s:.3f} s")
        self._wake_pump()
        return report

    async def command(
        self,
        symbol: str,
        arguments: Mapping[str, object] | None = None,
        listener: ProgressListener | None = None,
        started: Callable[[int], None] | None = None,
    ) -> CommandOutcome:
        """Writes a command to the input tape and waits until the net emits ``<symbol>_done`` or ``<symbol>_failed``.

        Args:
            symbol: Symbol of the command.
            arguments: What actions find in ``ctx.command.arguments``.
            listener: Is told of progress.
            started: Is told the number of the command, by which it can be cancelled.

        Raises:
            NotFoundError: No net knows the symbol.
        """
        executive = self._net_of_symbol(symbol)
        self._commands += 1
        command = Command(self._commands, symbol, dict(arguments or {}))
        promise = self.promise()
        if listener is not None:
            self._listeners[command.id] = listener
        if started is not None:
            started(command.id)

        def closed(result: CommandResult) -> None:
            if not promise.done():
                promise.set_result(result)

        executive.command(command, closed)
        try:
            result = await promise
        finally:
            self._listeners.pop(command.id, None)
        status = ok_status() if result.error is None else to_status(result.error)
        return CommandOutcome(result.success, status, result.results)

    def cancel(self, command_id: int, why: str = "cancelled by its client") -> None:
        """Asks a command to end early; the nets decide how."""
        error = ImError(why, code="cancelled", command_id=command_id)
        for executive in self.exchange.nets.values():
            executive.post(CommandCancelled(command_id, error))

    def symbols(self) -> list[str]:
        """Returns the symbols that the nets of this node read from their tapes."""
        return sorted({symbol for executive in self.exchange.nets.values() for symbol in executive.net.symbols()})

    def guards_changed(self) -> None:
        """Has guards looked at again; call it when something they read has changed. From any thread."""
        for executive in self.exchange.nets.values():
            executive.post(GuardsChanged())

    # The loop.

    def _wake_pump(self) -> None:
        if not self._pumping or threading.get_ident() != self._loop_thread:
            self._pump_timer.reset()

    def _pump_once(self) -> None:
        self._pump_timer.cancel()
        if not self.ready and not self._stopped:
            return
        self._loop_thread = threading.get_ident()
        self._pumping = True
        try:
            more = [executive.pump() for executive in list(self.exchange.nets.values())]
        finally:
            self._pumping = False
        for executive in self._changed.values():
            self._publisher.marking(executive)
        self._changed.clear()
        if any(more) or any(executive.due for executive in list(self.exchange.nets.values())):
            self._pump_timer.reset()

    def _spawn(self, work: Coroutine[object, object, None]) -> None:
        self.executor.create_task(work)
        self.wake()

    def _keep_house(self) -> None:
        for executive in self.exchange.nets.values():
            executive.expire()
        self.exchange.tidy()
        partners = self.exchange.partners()
        self._known_incarnation = {node: i for node, i in self._known_incarnation.items() if node in partners}
        for node in partners:
            incarnation = self.heartbeats.incarnation(node)
            if incarnation is not None:
                self._known_incarnation.setdefault(node, incarnation)
            missing = self.heartbeats.missing(node, self._known_incarnation.get(node))
            if missing:
                self._known_incarnation.pop(node, None)
                self.exchange.node_lost(node, missing)

    # What arrives.

    def _accept(self, sender: str, message: object) -> str:
        return self.exchange.receive(sender, message)

    def _take_back(self, message: object, why: str) -> None:
        self.exchange.refused(message, why)

    def _object_changed(self, change: ObjectChange) -> None:
        if not change.object.valid:
            for executive in self.exchange.nets.values():
                executive.post(ObjectInvalidated(change.object.name))

    def _check_objects(self, names: tuple[str, ...], done: Callable[[ImError | None], None]) -> None:
        self._spawn(self._look_at(names, done))

    async def _look_at(self, names: tuple[str, ...], done: Callable[[ImError | None], None]) -> None:
        try:
            for name in names:
                if not await self.dom.is_valid(name):
                    raise DataError(f"data object {name} is not valid although its place is to be marked", object=name)
        except ImError as error:
            done(error)
        else:
            done(None)

    def _net_of_symbol(self, symbol: str) -> Executive:
        for executive in self.exchange.nets.values():
            if symbol in executive.net.symbols():
                return executive
        raise NotFoundError(kind="command", name=symbol, known=self.symbols())

    def _fired(self, firing: Firing) -> None:
        self._publisher.firing(firing)
        self._changed[firing.net] = self.exchange.nets[firing.net]
        listener = self._listeners.get(firing.command_id)
        if listener is not None and firing.phase is Phase.START:
            listener(firing.transition, "", firing.progress)

    def _progressed(self, job: Job | None, text: str, fraction: float) -> None:
        listener = self._listeners.get(job.command.id) if job else None
        if listener is not None:
            listener("", text, fraction)


class _NodeObserver(Observer):
    """Passes what nets tell on to their node."""

    def __init__(self, node: PntNode) -> None:
        self._node = node

    def fired(self, firing: Firing) -> None:
        self._node._fired(firing)

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        self._node._progressed(job, text, fraction)

    def troubled(self, net: str, text: str) -> None:
        self._node.get_logger().warning(f"net {net}: {text}" if net else text)
