"""Base class of the nodes with nets: the Dispatcher and the Coordinators."""

import gc
import inspect
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from rclpy.exceptions import NameValidationException
from rclpy.parameter import Parameter

from im_core.clock import monotonic
from im_core.errors import FOREIGN, ImError, StateError, as_exception
from im_core.names import ESTOP, RESUMES, RUN, results_dir, run_dir
from im_core.ros import qos
from im_core.ros.calls import LONGEST_S, pause, run_in_thread
from im_core.ros.coroutines import calling
from im_core.ros.dom import DomClient
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_core.startup import net_digest, nets_sentence
from im_core.unfinished_commands import OpenCommandNote, noted, set_aside
from im_msgs.msg import ObjectChange
from im_pnt.errors import JournalError, NetError
from im_pnt.execution.actions import Ask, FunctionRunner
from im_pnt.execution.events import CommandCancelled, CommandHeld
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, ActionFunction, AskFunction, Functions, GuardFunction
from im_pnt.execution.jobs import Activity
from im_pnt.execution.strategies import StrategyBook
from im_pnt.expression.scope import check_net
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.groups import require_one_reader
from im_pnt.model.net import Net
from im_pnt.netfile import yaml_text
from im_pnt.verification import Verification, Verifier, accept
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.distributed.packets import began_at, new_epoch
from im_pnt_node.journal.journal import Journal
from im_pnt_node.journal.log import Sync
from im_pnt_node.journal.state import restore_net, taken_over
from im_pnt_node.journal.strategies import StrategyStore
from im_pnt_node.rerun.log import MissionLog
from im_pnt_node.ros.commands.commands import CommandOutcome, Commands, OpenCommand, ProgressListener
from im_pnt_node.ros.commands.control import ControlService
from im_pnt_node.ros.commands.execute import ExecuteServer, RunCommand
from im_pnt_node.ros.commands.notes import CommandNotes
from im_pnt_node.ros.execution.actions import RosAction, ServiceActions, Surroundings, TopicActions
from im_pnt_node.ros.execution.awaits import AwaitActions
from im_pnt_node.ros.execution.endpoints import EndpointGoesError, require_one_type
from im_pnt_node.ros.execution.goals import GoalActions
from im_pnt_node.ros.execution.loop import NetLoop
from im_pnt_node.ros.execution.transport import DdsTransport
from im_pnt_node.ros.library import Library, Loader
from im_pnt_node.ros.messages import RosTypes
from im_pnt_node.ros.objects.objects import DomObjects
from im_pnt_node.ros.objects.scopes import CommandScopes
from im_pnt_node.ros.objects.sources import Sources
from im_pnt_node.ros.objects.validity import Validity
from im_pnt_node.ros.reporting.mission import MissionPublisher, NotedAnswers, NotedObjects, NotedRequests
from im_pnt_node.ros.reporting.observer import NodeObserver
from im_pnt_node.ros.reporting.publish import PntPublisher

__all__ = ["CommandOutcome", "OpenCommand", "PntNode", "ProgressListener"]

TIDY_PERIOD_S = 2.0
ENDPOINT_GOES_S = 0.05
"""After so long the executor has let go of what a former net reached others with [s]."""
WRITTEN_S = 0.1
"""How often it is looked whether a journal that could not be written is [s]."""
ANSWER_S = 3.0
"""How long who cancels, pauses or operates waits for a journal that cannot be written [s]."""


class PntNode(ManagedNode):
    """ROS shell of nets in execution.

    Parameters: ``seed`` of choices; ``journal_dir``, folder of the journals of nets, from which a node that died goes
    on (default: in the run folder of the machine; empty, as for a node alone: no journal is kept); ``journal_sync``,
    when a record counts as written: ``os`` (default), it survives the death of the process; ``disk``, also the loss of
    power, and every firing waits for the disk.

    Args:
        name: Name of the node.
        net_files: Net files to load, verify and run.
        functions: Actions, builders and handlers that the nets name.
        guards: Enabling functions that the nets name.
        asks: For actions by name, what finds out what became of them.
        verifier: Says whether nets may run together; none runs without.
        made_by: What makes the functions for a :class:`im_pnt_node.rerun.host.Host`, as ``module:function``, so that a
            recorded mission can be run again; empty: nothing does.

    Attributes:
        log: What the nets can be run again from.
        objects: The data objects, for functions of nets; what these read and store is noted.
        dom: Client of the Data Object Manager.
        heartbeats: Tells who is alive.
        sources: What guards look at.
        exchange: The nets, and what they send each other.
        commands: The commands that have not ended.
        loader: Finds out whether a net may run.
        seed: Seed of choices.
    """

    def __init__(
        self,
        name: str,
        net_files: Sequence[str | Path] = (),
        functions: Mapping[str, Callable[..., object]] | None = None,
        guards: Mapping[str, GuardFunction] | None = None,
        asks: Mapping[str, AskFunction] | None = None,
        *,
        verifier: Verifier,
        made_by: str = "",
        parameter_overrides: list[Parameter] | None = None,
    ) -> None:
        super().__init__(name, parameter_overrides=parameter_overrides)
        self.functions = Functions(functions, guards, asks)
        self.heartbeats = Heartbeats(self)
        self.log = MissionLog()
        self.dom = DomClient(self)
        self.objects = NotedObjects(self.dom, self.log)
        self.sources = Sources(self, self.dom, self.log, self._source_changed)
        declare = self.declared.declare
        self.seed = declare("seed", 0, "of the choices among transitions in conflict", span=(0, 2**31 - 1))
        journals = "" if self.get_parameter("standalone").value else str(run_dir() / "journal")
        kept = "what a firing waits for: os, that the kernel has it (survives kill -9); disk, that the disk has it"
        self._journal_sync = Sync(declare("journal_sync", Sync.OS.value, kept, known=[kind.value for kind in Sync]))
        self._journal_dir = declare("journal_dir", journals, "folder of the journals; empty: none are kept")
        self._publisher = PntPublisher(self)
        self._observer = NodeObserver(self, self._publisher)
        epoch = new_epoch()
        self._transport = DdsTransport(self, epoch, self.heartbeats, self._observer)
        self.exchange = Exchange(name, began_at(epoch), self._transport, self._observer)
        self._publisher.nets = self.exchange.nets
        nets = self.exchange.nets
        self._mission = MissionPublisher(self, self.log, made_by, lambda: list(nets.values()), self.sources.tell)
        self._validity = Validity(self, self.dom, nets, self._object_settled)
        self._objects = DomObjects(self.objects, self.spawn, self._guards_changed)
        self._loop = NetLoop(self, self.exchange.nets, self._may_turn, self._commit, self._told)
        self.commands = self._observer.commands = Commands(
            self, self.exchange.nets, lambda: self._notes.changed(), self._command_ended
        )
        self._scopes = CommandScopes(self, self.dom, self.commands.scopes)
        run_folder = Path(self._journal_dir).parent if self._journal_dir else None
        self._notes = CommandNotes(self, run_folder, self.commands.noted)
        self._library = Library([Path(file) for file in net_files], verifier)
        self.loader = Loader(self, self._library, self.exchange.nets, self._publisher)
        around = Surroundings(self, self.functions, self.heartbeats, self.log, self._keep)
        goals = GoalActions(around, self.spawn, lambda: self.exchange.book.life)
        awaits = AwaitActions(around)
        self._kinds: dict[type, RosAction] = {
            ServiceAction: ServiceActions(around),
            GoalAction: goals,
            TopicAction: TopicActions(around),
            AwaitAction: awaits,
        }
        answers = NotedAnswers(self.log)
        questions: dict[type, Ask] = {GoalAction: answers(goals.ask), AwaitAction: awaits.ask}
        others = {kind: actions.perform for kind, actions in self._kinds.items()}
        requests = NotedRequests(self.exchange, self.log)
        self._runner = FunctionRunner(self.functions, requests, self.spawn, others, questions, apart=self._run_apart)
        self._journal: Journal | None = None
        self._book: StrategyBook = StrategyBook()
        self._looked = False
        self._execute: ExecuteServer | None = None
        self.create_subscription(ObjectChange, "/dom/changes", self._object_changed, qos.LATCHED_EVENTS)
        self.heartbeats.on_return(self._task_returned)
        self.dom.damaged = self._observer.lost_object

    # For subclasses.

    def phase_configure(self) -> None:
        """Load and verify the nets, and restore the state in the journal.

        Raises:
            ImError: A net file is wrong, a net is refused, or the journal is damaged.
        """
        self._book = StrategyStore(results_dir() / f"strategies-{self.task_name}.json")
        if self._journal_dir:
            folder = Path(self._journal_dir) / self.task_name
            run = os.environ.get(RUN, "")
            self._journal = Journal(
                folder, self.task_name, sync=self._journal_sync, observer=self._observer, run=run, store=self.dom.seen
            )
            self.commands.lost = self._journal.lost
            self._library.keep_in(folder / "nets")
        for net in self.completed(self._library.nets(self._journal.found if self._journal else {})):
            self._take_in(net, self._library.verify([net]))
        self._prepare_partners()
        self.detail = nets_sentence(self.exchange.nets)
        self.nets = {name: net_digest(yaml_text(each.written)) for name, each in self.exchange.nets.items()}
        stopped = bool(self._journal_dir) and (Path(self._journal_dir).parent / ESTOP).exists()
        held = None if self._journal is None or self._journal.of_this_run else stopped or not os.environ.get(RESUMES)
        goes_on = self._journal is not None and self._journal.start(self.exchange, self._transport.link, held)
        before: list[OpenCommandNote] = []
        if self._journal is not None:
            beside, name = Path(self._journal_dir).parent, self.task_name
            before = [each for each in noted(beside) if each.task == name]
            self.commands.ended.keep_in(beside / "ended" / f"{name}.jsonl", sync=self._journal_sync is Sync.DISK)
            self.commands.give_up([each for each in set_aside(beside) if each[0].task == name])
        self.commands.take_up()
        lacks = f"the journal of {self.task_name} does not know it: it is gone or an old copy, or has lost its end"
        self.commands.end_forgotten(before, self.commands.lost or lacks)
        if stopped:
            for command in self.commands.open():
                self.hold(command.job.command.id, True)
        if goes_on:
            self._observer.restarted(self.task_name)
            how = "is paused" if held or stopped else "goes on"
            self.get_logger().info(f"{self.task_name} {how} where its journal ends")
            for executor in self.exchange.nets.values():
                self._publisher.marked(executor)
        self._transport.listen(self.exchange, self._loop)
        self._library.follow(self)

    def completed(self, nets: list[Net]) -> list[Net]:
        """Return the first nets, of files or of a journal, completed by a subclass.

        Raises:
            NetError: They cannot be together.
        """
        self.require_together(nets)
        return nets

    def require_together(self, nets: Iterable[Net]) -> None:
        """Check whether nets can run together in the node.

        Raises:
            NetError: They cannot.
        """
        require_one_reader(nets)

    def phase_start(self) -> None:
        """Begin to fire."""
        ControlService(self, self.exchange.nets, self._on_file)
        self.create_timer(TIDY_PERIOD_S, self._tidy, clock=self.steady_clock)
        self.spawn(self._begin())
        self.spawn(self._scopes.begin())
        gc.freeze()  # what is there now stays: the garbage collector need not look at it again, which takes 20 ms

    def phase_shutdown(self) -> None:
        """End open work."""
        self._notes.write_last()
        error = ImError(f"{self.task_name} is shutting down", code="cancelled")
        for executor in self.exchange.nets.values():
            executor.post(CommandCancelled(None, error))

    def destroy_node(self) -> None:
        """Close the journal; the files stay on the disk."""
        if self._journal is not None:
            self._journal.close()
        super().destroy_node()

    async def load_net(self, net: Net, patience_s: float = 0.0) -> Verification:
        """Verify a net, alone and with the partners, and take the net into execution.

        Args:
            net: The net; it takes the place of one of the same name when that one is at rest.
            patience_s: Longest wait for that [s].

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It names a function that is not registered, does not fit to the present marking, or has a command
                that another net has.
            StateError: The present net of that name does not come to rest; says what keeps it.
            WaitTimeoutError: ``/dom`` does not say whether the data objects are valid that its guards are woken by.
            JournalError: The journal cannot be written; all is as it was.
        """
        self.require_together([*(each.written for name, each in self.exchange.nets.items() if name != net.name), net])
        return await self.load_beside(net, patience_s, (), nullcontext)

    async def load_beside(
        self, net: Net, patience_s: float, beside: Sequence[Net], around: Callable[[], AbstractContextManager[None]]
    ) -> Verification:
        """As :meth:`load_net`, of a net with which others change.

        Args:
            net: The net.
            patience_s: As there.
            beside: Nets that take the places of those of their names in the same turn; verified with it.
            around: Entered in that turn before it comes, where it may still be refused, and left when it has come.

        Raises:
            ImError: As there, and what ``around`` raises.
        """
        await run_in_thread(self, self.functions.check, net)  # a user's module may take long to import
        wakes = self.functions.wakes(net)
        self.sources.check_topics(net.name, wakes)
        try:
            await self.sources.meet(wakes)  # before it comes: nobody has to wait for /dom with it
            report = await self._take_place(net, patience_s, beside, around)
        except ImError:
            self._keep_sources()
            raise
        self._library.tidy([executor.written for executor in self.exchange.nets.values()])
        if self._execute is not None:
            self._execute.tell()
        return report

    async def unload_net(self, name: str, patience_s: float = 0.0) -> None:
        """Take a net out of execution once the net is at rest.

        Args:
            name: Its name.
            patience_s: Longest wait for that [s].

        Raises:
            NotFoundError: There is none of that name.
            StateError: Another net of this node asks it, or it does not come to rest; says what keeps it.
            JournalError: The journal cannot be written; all is as it was.
        """
        await self.unload_beside(name, patience_s, (), nullcontext)

    async def unload_beside(
        self, name: str, patience_s: float, beside: Sequence[Net], around: Callable[[], AbstractContextManager[None]]
    ) -> None:
        """As :meth:`unload_net`, of a net with which others change.

        Args:
            name: Its name.
            patience_s: As there.
            beside: Nets that take the places of those of their names in the same turn, and ask it no more.
            around: Entered in that turn before it goes, where it may still be refused, and left when it has gone.

        Raises:
            ImError: As there, and what ``around`` raises.
        """
        await self.loader.until_it_may_go(name, patience_s, beside)
        with around():
            self._take_out(name)
        if self._execute is not None:
            self._execute.tell()

    async def command(
        self,
        symbol: str,
        arguments: Mapping[str, object] | None = None,
        listener: ProgressListener | None = None,
        started: Callable[[int], None] | None = None,
        priority: int = 0,
    ) -> CommandOutcome:
        """Write a command to the input tape and wait until the net emits ``<symbol>_done`` or ``<symbol>_failed``.

        Args:
            symbol: Symbol of the command.
            arguments: What actions find in ``ctx.command.arguments``.
            listener: Is told of progress.
            started: Is told the number of the command, by which it can be cancelled.
            priority: Larger goes first, where commands wait for the same.

        Raises:
            StateError: The node has failed, as with a net that is wrong.
            NotFoundError: No net knows the symbol.
            DataError: The arguments are not what the net declares.
            JournalError: The journal cannot be written: the command would not even begin.
        """
        if self.failed:
            raise StateError(f"{self.task_name} has failed: {self.failed}")
        if self._journal is not None:
            self._journal.require_writable()
        number = self.commands.write(symbol, arguments or {}, priority)
        if started is not None:
            started(number)
        return await self.commands.wait(number, listener)

    def offer_commands(self, run: RunCommand | None = None) -> None:
        """Offer the commands of the nets: action ``/<node>/execute``, list ``/<node>/commands``.

        Args:
            run: Runs a command; None: :meth:`command`.
        """
        run = run or self.command
        self._execute = ExecuteServer(self, self.exchange.nets, self.commands, run, self, self._written, self._on_file)

    def net_with_servers(self, name: str) -> list[Net]:
        """Return a net of the node as written, with the needed known nets of all nodes."""
        own = [executor.written for executor in self.exchange.nets.values()]
        return self._library.with_servers(self.exchange.nets[name].written, own)

    def cancel(self, command_id: int, why: str = "cancelled by its client") -> None:
        """Ask a command to end early, also a paused one; the nets decide how."""
        error = ImError(why, code="cancelled", command_id=command_id)
        for executor in self.exchange.nets.values():
            executor.post(CommandCancelled(command_id, error))

    def hold(self, command_id: int, held: bool) -> None:
        """Begin nothing more for a command (running actions end), or let the command go on.

        Raises:
            StateError: It is to be held, and has ended.
        """
        scope = self.commands.get(command_id).job.command.scope if held else ""
        for executor in self.exchange.nets.values():
            if held != (command_id in executor.rule.held):
                executor.post(CommandHeld(command_id, held, scope))

    def explained(self, command: OpenCommand) -> tuple[Sequence[str], str]:
        """Return the resources of a command, and the resources still awaited; PntNode knows none."""
        return (), ""

    # Nets.

    def succeed(self, net: Net, report: Verification) -> None:
        """Replace a net in execution by another of the name, with the jobs.

        Data objects that only its guards are woken by count as not valid until ``/dom`` has answered.

        Args:
            net: The net.
            report: Says that it may run.

        Raises:
            StateError: Something is under way in the present net that the new one does not have.
            JournalError: The journal cannot be written. It has taken the place all the same, and nothing leaves until
                that can be written.
        """
        present = self.exchange.nets[net.name]
        while self._loop.pump(present):
            pass
        state = taken_over(present, net)
        self._take_in(self._library.kept(net), report, state, self.exchange.succeed)
        self._prepare_partners()
        self.spawn(self.sources.look())
        self.exchange.nets[net.name].resume()
        self.commands.take_up()
        if self._execute is not None:
            self._execute.tell()
        if self._journal is not None:
            self._journal.renew()
        self._library.tidy([executor.written for executor in self.exchange.nets.values()])

    async def _take_place(
        self,
        net: Net,
        patience_s: float,
        beside: Sequence[Net],
        around: Callable[[], AbstractContextManager[None]],
    ) -> Verification:
        """Take in a verified net, once the present net of the name is at rest."""
        while True:
            report, state = await self.loader.prepare(net, patience_s, beside)
            former = self.exchange.nets.get(net.name)
            try:
                with around():
                    self._take_in(self._library.kept(net), report, state)
                    self._prepare_partners()
                    self._write_down(net.name, former)
            except EndpointGoesError:
                await pause(self, ENDPOINT_GOES_S)
            else:
                return report

    def _write_down(self, name: str, former: Executor | None) -> None:
        """Write a new net into the journal, or take the net out again: a journal of other nets restores nothing.

        Raises:
            JournalError: The journal cannot be written; all is as it was.
            NetError: Likewise.
        """
        try:
            if self._journal is not None:
                self._journal.compact()
        except (JournalError, NetError):
            if former is None:
                del self.exchange.nets[name]
                self._publisher.withdrawn(name)
            else:
                self.exchange.nets[name] = former
                self._publisher.described(former)
                self._publisher.marked(former)
            raise

    def _take_out(self, name: str) -> None:
        """Take a net out of execution, and out of the journal.

        Raises:
            JournalError: The journal cannot be written; all is as it was.
            NetError: Likewise.
        """
        nets = self.exchange.nets
        before = dict(nets)
        del nets[name]
        if self._journal is not None:
            try:
                self._journal.compact()
            except (JournalError, NetError):
                nets.clear()
                nets.update(before)  # in the order in which they were
                raise
        self._publisher.withdrawn(name)
        self._keep_sources()

    def _prepare_partners(self) -> None:
        """Prepare the ways to the nets of other nodes, for all partners of the nets of the node."""
        nets = self.exchange.nets
        for partner in {name for executor in nets.values() for name in executor.written.partners()} - nets.keys():
            self._transport.prepare(partner)

    def _take_in(
        self,
        net: Net,
        report: Verification,
        state: dict[str, object] | None = None,
        enter: Callable[[Executor], None] | None = None,
    ) -> None:
        check_net(net, RosTypes())
        self.functions.check(net)
        accept(report)
        if report.unproved:
            self._observer.unproved(report.sentence)
        else:
            self.get_logger().info(report.sentence)
        self.sources.check_topics(net.name, self.functions.wakes(net))
        require_one_type(net, [each.written for name, each in self.exchange.nets.items() if name != net.name])
        for transition in net.transitions.values():
            action = transition.action
            if action is not None and type(action) in self._kinds:
                try:
                    self._kinds[type(action)].prepare(action)
                except (RuntimeError, ValueError, NameValidationException) as error:  # the middleware has its rules
                    why = " ".join(str(error).split())
                    text = f"{net.name}.{transition.name}: {action} cannot be prepared: {why}"
                    raise NetError(text, net=net.name, transition=transition.name) from error
        journal = self._journal
        executor = Executor(
            net,
            self.functions,
            self._runner if journal is None else journal.guard(self._runner),
            self.exchange,
            self._observer,
            seed=self.seed,
            wake=self._loop.wake,
            check_objects=lambda names, done: self.spawn(self.sources.check(names, done)),
            record=None if journal is None else journal.recorder(net.name, self.log.items.append),
            strategies=self._book,
            objects=self._objects,
        )
        if state is not None:
            restore_net(executor, state)
        elif net.name in self.exchange.nets:
            executor.count_on(self.exchange.nets[net.name])
        (enter or self.exchange.add)(executor)
        self.sources.declare(self.functions.wakes(net))
        self._mission.loaded(executor)
        self._publisher.described(executor)
        self._publisher.marked(executor)
        self._loop.wake()

    def _keep_sources(self) -> None:
        """Stop following the objects needed only by guards of removed nets."""
        nets = self.exchange.nets.values()
        self.sources.keep({source for executor in nets for source in self.functions.wakes(executor.written)})

    async def _run_apart(self, function: ActionFunction, context: ActionContext) -> None:
        """Call a function in a separate thread, so the function may block."""

        def post(work: Callable[[], None]) -> None:
            self.spawn(calling(work))

        apart = context.apart(post)
        outcome = await run_in_thread(self, _outcome_of, function, apart, tell_after_s=LONGEST_S)
        try:
            if isinstance(outcome, Exception):
                raise outcome
            if inspect.isawaitable(outcome):
                await outcome
        finally:
            apart.leave()

    def _keep(self, activity: Activity) -> None:
        """Write the notes of a builder in the job to the journal, before the request leaves.

        Raises:
            NetError: JSON cannot carry it.
            JournalError: It cannot be written.
        """
        self.exchange.nets[activity.net].built(activity)
        if self._journal is not None:
            self._journal.write()

    def _command_ended(self) -> None:
        under_way = {command.job.command.id for command in self.commands.open()}
        for executor in self.exchange.nets.values():
            for number in [each for each in executor.rule.held if each > 0 and each not in under_way]:
                executor.post(CommandHeld(number, False))  # one that was ended while it was paused
        self._scopes.tidy()
        self._notes.changed()

    # The loop.

    async def _begin(self) -> None:
        """Read the data objects of guards and marked places; nothing fires before."""
        await self._compare_objects()
        self._looked = True
        self._mission.begin()
        self._loop.wake()

    def _task_returned(self, task: str) -> None:
        self._observer.restarted(task)
        if task == "dom":
            self.spawn(self._compare_objects())

    async def _compare_objects(self) -> None:
        """Make tokens and guards follow the objects: changes told by /dom while the node or /dom was dead are lost."""
        self.dom.forget_known()
        self.spawn(self._compare_store())
        self._objects.stale()
        await self.sources.look()
        await self._validity.compare()
        self._guards_changed()

    async def _compare_store(self) -> None:
        """Has it said if the store of /dom has lost what this node has seen; nothing waits for that."""
        try:
            await self.dom.compare_store()
        except ImError as error:  # the next answer of the store tells
            self.get_logger().warning(f"whether the object store has lost anything is not known yet: {error.message}")

    def _may_turn(self) -> bool:
        return (self.ready and self._looked) or self._stopped

    def _tidy(self) -> None:
        """Give up requests without a waiting job, and write the journal entries of the change."""
        self.exchange.tidy()
        self._loop.turn()

    def _told(self) -> None:
        self._validity.turned()
        self._publisher.publish()
        self._mission.publish()

    async def _written(self, longest_s: float = math.inf) -> None:
        """Wait until a request is in the journal, and noted for the next start of the machine.

        Args:
            longest_s: Longest wait for a journal that cannot be written [s].

        Raises:
            JournalError: It cannot be written.
        """
        while not self._may_turn():
            await pause(self, WRITTEN_S)
        self._loop.turn()
        deadline = monotonic() + longest_s
        while self._journal is not None and self._journal.unwritten:  # the loop tries again
            if monotonic() >= deadline:
                self._journal.write()
            await pause(self, WRITTEN_S)
        await self._notes.written()

    async def _on_file(self) -> str:
        """Wait likewise, but briefly; return a remark for an answer: empty, or the reason for not being on file."""
        try:
            await self._written(ANSWER_S)
        except JournalError as error:
            return f"; it is done, but not on file: {error.message}"
        return ""

    def _commit(self) -> None:
        if self._journal is not None:
            self._journal.commit()
        self._transport.flush()

    # What arrives.

    def _guards_changed(self) -> None:
        for executor in self.exchange.nets.values():
            executor.guards_changed()

    def _source_changed(self, source: str) -> None:
        for executor in self.exchange.nets.values():
            if source in self.functions.wakes(executor.written):
                executor.guards_changed(source)
        if not self._may_turn():  # what is told after a turn would pile up until there is one
            self._mission.publish()

    def _object_changed(self, change: ObjectChange) -> None:
        self.dom.heard(change.object)
        name, valid = change.object.name, bool(change.object.valid)
        if self._validity.shows(name) or self.sources.follows(name):
            self._validity.look(name)
        else:
            self._object_settled(name, valid)

    def _object_settled(self, name: str, valid: bool) -> None:
        """Take in the state of a changed data object."""
        self.log.add("object", name, valid)
        self.sources.object_changed(name, valid)
        if self._objects.forget(name):
            self._guards_changed()
        if not valid:
            self._validity.lost(name)


def _outcome_of(function: ActionFunction, context: ActionContext) -> object:
    """Return the result of a function, or the raised exception."""
    try:
        return function(context)
    except FOREIGN as error:  # it is foreign code: whatever it raises is its failure
        return as_exception(error)
