"""Base class of the nodes with nets: the Dispatcher and the Coordinators."""

import gc
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from rclpy.parameter import Parameter

from im_core.errors import ConfigError, ImError
from im_core.names import ESTOP, RESUMES, RUN, results_dir, run_dir
from im_core.processes.startup import net_digest, nets_sentence
from im_core.ros.dom import DomClient
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import AskFunction, Functions, GuardFunction
from im_pnt.execution.journal_entries import Record
from im_pnt.execution.strategies import StrategyBook
from im_pnt.model.groups import require_one_reader
from im_pnt.model.net import Net
from im_pnt.netfile import yaml_text
from im_pnt.verification import Verification, Verifier
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.distributed.packets import began_at, new_epoch
from im_pnt_node.journal.journal import Journal
from im_pnt_node.journal.log import Sync
from im_pnt_node.journal.strategies import StrategyStore
from im_pnt_node.rerun.log import MissionLog
from im_pnt_node.ros.commands.commands import CommandOutcome, Commands, OpenCommand, ProgressListener
from im_pnt_node.ros.commands.control import ControlService
from im_pnt_node.ros.commands.execute import ExecuteServer, RunCommand
from im_pnt_node.ros.execution.goals import read_remap
from im_pnt_node.ros.execution.loop import NetLoop
from im_pnt_node.ros.execution.runner import NodeRunner
from im_pnt_node.ros.execution.transport import DdsTransport
from im_pnt_node.ros.library import Library
from im_pnt_node.ros.loader import Loader
from im_pnt_node.ros.objects.objects import DomObjects
from im_pnt_node.ros.objects.sources import Sources
from im_pnt_node.ros.objects.validity import Validity
from im_pnt_node.ros.reporting.mission import MissionPublisher, NotedObjects
from im_pnt_node.ros.reporting.observer import NodeObserver
from im_pnt_node.ros.reporting.publish import PntPublisher

__all__ = ["CommandOutcome", "OpenCommand", "PntNode", "ProgressListener"]

TIDY_PERIOD_S = 2.0


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
        values: The same as JSON data, for expressions and functions of nets.
        dom: Client of the Data Object Manager.
        heartbeats: Tells who is alive.
        sources: What guards look at.
        exchange: The nets, and what they send each other.
        commands: The commands that have not ended.
        loader: Takes nets in and out.
        seed: Seed of choices.
        begun: Whether the nets may fire: those of changed files are there, and data objects are read.
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
        self.sources = Sources(self, self.dom, self.log, self._guards_changed)
        declare = self.declared.declare
        self.seed = declare("seed", 0, "of the choices among transitions in conflict", span=(0, 2**31 - 1))
        journals = "" if self.get_parameter("standalone").value else str(run_dir() / "journal")
        kept = "what a firing waits for: os, that the kernel has it (survives kill -9); disk, that the disk has it"
        self._journal_sync = Sync(declare("journal_sync", Sync.OS.value, kept, known=[kind.value for kind in Sync]))
        folder = declare("journal_dir", journals, "folder of the journals; empty: none are kept")
        self._journal_dir = Path(folder) if folder else None
        self._publisher = PntPublisher(self)
        self._observer = NodeObserver(self, self._publisher)
        epoch = new_epoch()
        self._transport = DdsTransport(self, epoch, self.heartbeats, self._observer)
        self.exchange = Exchange(name, began_at(epoch), self._transport, self._observer)
        nets = self._publisher.nets = self.exchange.nets
        self._mission = MissionPublisher(self, self.log, made_by, lambda: list(nets.values()), self.sources.tell)
        self.values = DomObjects(self.objects, self.spawn, self._guards_changed)
        self._validity = Validity(self, self.dom, nets, self.log, self.sources, self.values, self._guards_changed)
        self._loop = NetLoop(self, nets, self._may_turn, self._transport.flush, self._told)
        run_folder = self._journal_dir.parent if self._journal_dir else None
        self.commands = self._observer.commands = Commands(self, nets, self._loop, self.dom, run_folder)
        remap: dict[str, str] = {}
        try:
            remap = read_remap(declare("remap", "", "ROS actions of nets under new names: /old:=/new, ... with commas"))
        except ConfigError as error:
            self.declared.fault = self.declared.fault or error
        self._runner = NodeRunner(self, self.functions, self.exchange, self.heartbeats, self.log, self._loop, remap)
        self._library = Library([Path(file) for file in net_files], verifier)
        self.loader = Loader(
            self,
            self._library,
            self.exchange,
            self.functions,
            self._runner,
            self.sources,
            self._loop,
            self._transport,
            self.commands,
            self._observer,
            self._mission,
            self._executor,
            self._recorder,
        )
        self._book = StrategyBook()
        self.begun = False
        self.heartbeats.on_incarnation(self._task_began)
        self.dom.damaged = self._observer.lost_object

    def _executor(self, net: Net) -> Executor:
        journal = self._loop.journal
        return Executor(
            net,
            self.functions,
            self._runner if journal is None else journal.guard(self._runner),
            self.exchange,
            self._observer,
            seed=self.seed,
            wake=self._loop.wake,
            check_objects=lambda names, done: self.spawn(self.sources.check(names, done)),
            record=self._recorder(net.name),
            strategies=self._book,
            objects=self.values,
        )

    def _recorder(self, net: str) -> Record | None:
        journal = self._loop.journal
        return None if journal is None else journal.recorder(net, self.log.items.append)

    # For subclasses.

    def phase_configure(self) -> None:
        """Load and verify the nets, and restore the state in the journal.

        Raises:
            ImError: A net file is wrong, a net is refused, or the journal is damaged.
        """
        self._book = StrategyStore(
            results_dir() / f"strategies-{self.task_name}.json", lambda text: self._observer.troubled("", text)
        )
        journal, stopped, held = None, False, None
        if self._journal_dir is not None:
            folder, run = self._journal_dir / self.task_name, os.environ.get(RUN, "")
            journal = self._loop.journal = Journal(
                folder, self.task_name, sync=self._journal_sync, observer=self._observer, run=run, store=self.dom.seen
            )
            self._library.keep_in(folder / "nets")
            stopped = (self._journal_dir.parent / ESTOP).exists()
            held = None if journal.of_this_run else stopped or not os.environ.get(RESUMES)
        self.loader.begin(self.completed(self._library.nets(journal.found if journal else {}, RUN not in os.environ)))
        self._library.keep(executor.written for executor in self.exchange.nets.values())
        newer = {net.name for net in self._library.newer}
        for name in (name for name in self._library.changed if name not in newer):
            self.get_logger().warning(
                f"the file of net {name} has changed since the mission began, which goes on with the net as it was; "
                "load the file, or begin a new mission"
            )
        self.detail = nets_sentence(self.exchange.nets)
        nets = {name: each.written for name, each in self.exchange.nets.items() if not each.written.former}
        self.nets = {name: net_digest(yaml_text(net)) for name, net in nets.items()}
        goes_on = journal is not None and journal.start(self.exchange, self._transport.link, held)
        under_way = goes_on and not all(executor.at_rest() for executor in self.exchange.nets.values())
        self._runner.surroundings.waits_for_all = under_way or not self.get_parameter("standalone").value
        self.commands.restore(journal.lost if journal else "", sync=self._journal_sync is Sync.DISK)
        if stopped:
            for command in self.commands.open():
                self.commands.hold(command.job.command.id, True)
        if goes_on:
            self._observer.restarted(self.task_name)
            how = "is paused" if held or stopped else "goes on"
            self.get_logger().info(f"{self.task_name} {how} where its journal ends")
            for executor in self.exchange.nets.values():
                self._publisher.marked(executor)
        self._transport.listen(self.exchange, self._loop)
        self._library.follow(self, lambda: (executor.written for executor in self.exchange.nets.values()))

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
        ControlService(self, self.exchange.nets, self._book, self.commands.on_file)
        self.create_timer(TIDY_PERIOD_S, self._tidy, clock=self.steady_clock)
        self.spawn(self._begin())
        self.commands.begin()
        gc.freeze()  # what is there now stays: the garbage collector need not look at it again, which takes 20 ms

    def phase_shutdown(self) -> None:
        """End open work."""
        self.commands.end()

    def destroy_node(self) -> None:
        """Close the journal; the files stay on the disk."""
        if self._loop.journal is not None:
            self._loop.journal.close()
        super().destroy_node()

    async def load_net(self, net: Net, patience_s: float = 0.0) -> Verification:
        """Verify a net, alone and with the partners, and take the net into execution.

        Args:
            net: The net; it takes the place of one of the same name when that one is at rest.
            patience_s: Longest wait for that [s].

        Raises:
            ImError: As of :meth:`.Loader.load`, or another net reads one of its symbols; all is as it was.
        """
        self.require_together([*(each.written for name, each in self.exchange.nets.items() if name != net.name), net])
        return await self.loader.load(net, patience_s)

    def offer_commands(self, run: RunCommand | None = None) -> None:
        """Offer the commands of the nets: action ``/<node>/execute``, list ``/<node>/commands``.

        Args:
            run: Runs a command; None: :meth:`.Commands.run`.
        """
        runs, lacking = run or self.commands.run, self._library.left_out
        server = ExecuteServer(self, self.exchange.nets, self.commands, runs, self.explained, lacking)
        self.loader.changed = server.tell

    def net_with_servers(self, name: str) -> list[Net]:
        """Return a net of the node as written, with the needed known nets of all nodes."""
        own = [executor.written for executor in self.exchange.nets.values()]
        return self._library.with_servers(self.exchange.nets[name].written, own)

    def explained(self, command: OpenCommand) -> tuple[Sequence[str], str]:
        """Return the resources of a command, and the resources still awaited; PntNode knows none."""
        return (), ""

    # The loop.

    async def _begin(self) -> None:
        """Take newer nets, and read the data objects of guards and marked places; nothing fires before."""
        for net in self._library.newer:
            await self._renew(net)
        await self._validity.compare()
        self.begun = True
        self._mission.begin()
        self._loop.wake()

    async def _renew(self, net: Net) -> None:
        """Take a net in the place of the one that the journal has, unless that is busy."""
        told = f"net {net.name} of {net.source} is another than that of the journal"
        if busy := "; ".join(self.exchange.nets[net.name].at_rest().reasons):
            self.get_logger().warning(f"{told}, which is busy and goes on as it was: {busy}")
            return
        try:
            await self.load_net(net)
        except ImError as error:
            self.get_logger().warning(f"{told}, which goes on as it was: {error.message}")
        else:
            self.get_logger().info(f"{told}, and takes its place")

    def _task_began(self, task: str, again: bool) -> None:
        if again:
            self._observer.restarted(task)
        if task == "dom" and (again or self.dom.seen.mark is not None):  # one that was never heard may have answered
            self.spawn(self._validity.compare())

    def _may_turn(self) -> bool:
        return (self.ready and self.begun) or self._stopped

    def _tidy(self) -> None:
        """Give up requests without a waiting job, and write the journal entries of the change."""
        self.exchange.tidy()
        self._loop.turn()

    def _told(self) -> None:
        self._validity.turned()
        self._publisher.publish()
        self._mission.publish()
        self.loader.tidy()

    def _guards_changed(self, source: str = "") -> None:
        """Ask guards with a declared source again, or all."""
        for executor in self.exchange.nets.values():
            if not source or source in self.functions.wakes(executor.written):
                executor.guards_changed(source)
        if source and not self._may_turn():  # what is told after a turn would pile up until there is one
            self._mission.publish()
