"""Node ``/dispatcher``."""

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial

from im_cell.calibration_report import report_fields
from im_cell.robot import load_cell
from im_core.errors import ArgumentError, ImError, StateError
from im_core.ros import qos, run
from im_core.ros.calls import run_in_thread
from im_core.ros.coroutines import OneAtATime
from im_core.ros.messages.message_fields import filled
from im_dispatcher.cell import net as cell
from im_dispatcher.cell.needs import Needs, resources_of
from im_dispatcher.cell.queue import WaitingLine, reason
from im_dispatcher.command import joined
from im_dispatcher.commands import calibrate_camera, installed, load_named_net, net_files, parse_sent_net, shipped
from im_dispatcher.poses_file import load_named_poses
from im_dispatcher.report import StepTimes
from im_msgs.msg import Firing
from im_msgs.srv import CalibrateCamera, LoadNet, UnloadNet
from im_pnt.errors import JournalError
from im_pnt.execution.functions import Functions
from im_pnt.execution.jobs import Command, Job
from im_pnt.model.arguments import Busy
from im_pnt.model.net import Net
from im_pnt.verification import Verification
from im_pnt_analysis import verify_to_load
from im_pnt_node.journal.journal import fingerprint
from im_pnt_node.rerun.host import Host
from im_pnt_node.ros.node import CommandOutcome, OpenCommand, PntNode, ProgressListener
from im_pnt_node.ros.node_host import NodeHost

#: How long it may take to read a net [s].
READ_S = 60.0

#: How long a net that comes or goes may wait for the rest of one [s]; others wait for it meanwhile.
LONGEST_WAIT_S = 3600.0

#: Commands that may wait in the line.
MOST_WAITING = 100

#: Stands for the number of a command that has none yet: it is the last.
NO_NUMBER = 2**62


class Dispatcher(PntNode):
    """Root of the Coordination Level: the services and the action write commands to the input tape of the nets."""

    def __init__(self) -> None:
        host, commands = NodeHost(), installed()
        times = [StepTimes(partial(self._nets_for, command.net.stem), self._now) for command in commands]
        made = joined(command.functions(host, each) for command, each in zip(commands, times, strict=True))
        made_by = f"{__name__}:{dispatcher_functions.__name__}"
        name, verifier = "dispatcher", verify_to_load
        super().__init__(name, (), made.actions, made.guards, made.asks, verifier=verifier, made_by=made_by)
        named = "the commands to begin with: names of those shipped, net files, folders of them; separated by commas"
        self._commands_named = self.declared.declare("commands", ",".join(shipped()), named)
        host.attach(self)
        self.create_subscription(Firing, "/pnt/firings", partial(self._note_firing, times), qos.EVENTS)
        self._standing = {symbol: tell for command in commands for symbol, tell in command.standing.items()}
        self._resources = resources_of(load_cell())
        self._changes = OneAtATime(self.promise)
        self._know(Needs((), self._resources))

    def phase_configure(self) -> None:
        """Load the nets of the commands, and the net of the resources."""
        self._library.files = net_files(self._commands_named.split(","))
        super().phase_configure()
        for name, why in self._library.left_out.items():
            self.get_logger().warning(f"command net {name} is left out: {why}")

    def completed(self, nets: list[Net]) -> list[Net]:
        """Return the nets, preceded by the resource net, which hands commands on.

        A journal brings that back as it was: perhaps the process died between a net and what its commands need.
        """
        others = [net for net in nets if net.name != cell.NAME]
        self._know(Needs([net for net in others if not net.former], self._resources))
        before = [net for net in nets if net.name == cell.NAME]
        return [*(before or [self._library.kept(cell.cell_net(self._needs))]), *others]

    def require_together(self, nets: Iterable[Net]) -> None:
        """Check nets together; the net of the cell reads the commands, and hands the commands on."""
        super().require_together(net for net in nets if net.name != cell.NAME)

    def phase_start(self) -> None:
        """Start the nets, then take commands."""
        super().phase_start()
        self.create_service(CalibrateCamera, "/dispatcher/calibrate_camera", self._calibrate_camera)
        self.create_service(LoadNet, "/dispatcher/load_net", self._load_net)
        self.create_service(UnloadNet, "/dispatcher/unload_net", self._unload_net)
        self.offer_commands(self._run)
        self.spawn(self._complete_cell())

    async def _complete_cell(self) -> None:
        """Complete the loading or unloading of a net begun by a former incarnation."""
        try:
            async with self._changes:
                if self._is_other(cell.cell_net(self._needs)):
                    net, report = await self._cell_for(self._needs)
                    with self._cell_changes(self._needs, net, report):
                        pass
        except ImError as error:
            self.get_logger().error(f"what commands need is as before the last net came or went: {error.message}")

    async def load_net(self, net: Net, patience_s: float = 0.0) -> Verification:
        """Take a net into execution, and the needs of the commands into the net of the cell, in one turn.

        All nets that will run then are verified together before. One net comes or goes at a time; others wait.

        Raises:
            StateError: It would be the net of the cell, or commands wait or run that it would need otherwise.
        """
        if net.name == cell.NAME:
            raise StateError(f"net {net.name} is made of what commands need; load the nets of these")
        async with self._changes:
            # each at its place: in another order it would be another net of the cell
            nets = {each.name: each for each in self._command_nets()}
            needs = Needs([*{**nets, net.name: net}.values()], self._resources)
            self._line.require_same(needs)
            await self.loader.verified_alone(net)
            changed, report = await self._cell_for(needs, beside=[net])
            around = partial(self._cell_changes, needs, changed, report)
            return await self.loader.load(net, patience_s, [changed], around)

    async def unload_net(self, name: str, patience_s: float = 0.0) -> None:
        """Take a net out of execution, and the commands out of the net of the cell, in one turn.

        Raises:
            StateError: One of its commands waits or runs, or it is the net of the cell.
        """
        if name == cell.NAME:
            raise StateError(f"net {name} is made of what commands need; unload the nets of these")
        async with self._changes:
            needs = Needs([each for each in self._command_nets() if each.name != name], self._resources)
            self._line.require_same(needs)
            changed, report = await self._cell_for(needs, without=name)
            around = partial(self._cell_changes, needs, changed, report)
            await self.loader.unload(name, patience_s, [changed], around)

    def explained(self, command: OpenCommand) -> tuple[Sequence[str], str]:
        """Return the needs of a command in the cell, and the commands in the way, if any."""
        asked = command.job.command
        if asked.symbol not in self._needs:
            return (), ""
        claim = self._line.claim(asked)
        keepers = self._line.keepers(claim) if command.job.waiting else []
        return claim.variant.needs, reason(claim, keepers) if keepers else ""

    def _nets_for(self, net: str) -> Sequence[Net]:
        """Return a net as written, with all required nets; none before it is loaded."""
        return self.net_with_servers(net) if net in self.exchange.nets else ()

    def _now(self) -> float:
        """Return the testbed time [s]."""
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _note_firing(self, times: Iterable[StepTimes], message: Firing) -> None:
        executor = self.exchange.nets.get(message.net)
        message.net = (executor.written.former if executor is not None else "") or message.net
        note_firing(times, message)

    def _know(self, needs: Needs) -> None:
        """Set the needs for the queue of commands."""
        self._needs = needs
        self._line = WaitingLine(needs, lambda: self.exchange.nets[cell.NAME])
        self.functions.guards.update(self._line.guards())

    async def _cell_for(self, needs: Needs, beside: Sequence[Net] = (), without: str = "") -> tuple[Net, Verification]:
        """Make the net of the cell for other needs, and verify the net with all nets running later."""
        net = cell.cell_net(needs)
        return net, await self.loader.verified(net, beside, without)

    def _is_other(self, net: Net) -> bool:
        return fingerprint(net) != fingerprint(self.exchange.nets[cell.NAME].written)

    @contextmanager
    def _cell_changes(self, needs: Needs, net: Net, report: Verification) -> Iterator[None]:
        """Replace the net of the cell by one for the coming needs, with the coming or leaving net meanwhile.

        Raises:
            StateError: A command waits or runs that would need something else, or is not there any more.
        """
        self._line.require_same(needs)
        yield
        self._know(needs)
        if self._is_other(net):
            with suppress(JournalError):  # the loop tries again, and says so; nothing leaves before
                self.loader.succeed(net, report)

    def _command_nets(self) -> list[Net]:
        return [
            net for each in self.exchange.nets.values() if not (net := each.written).former and net.name != cell.NAME
        ]

    async def _run(
        self,
        symbol: str,
        arguments: dict[str, object],
        listener: ProgressListener | None = None,
        started: Callable[[int], None] | None = None,
        priority: int = 0,
    ) -> CommandOutcome:
        """Run a command; without free resources the command waits or is refused, by the declaration.

        Of a command that needs nothing, a second one is refused, but beside those of a former version of the net.

        Raises:
            StateError: It is refused; says who holds what, or that the cell does not hand it out yet.
        """
        if symbol == calibrate_camera.SYMBOL and "group" not in arguments:
            named = arguments.get("poses_file", "")
            if isinstance(named, str):  # what is wrong otherwise the schema says
                file = await run_in_thread(self, load_named_poses, named, timeout_s=READ_S)
                arguments = {**arguments, "group": file.group}
        if symbol not in self._needs:
            for each in self.commands.open():
                if each.job.command.symbol == symbol and not each.net.written.former:
                    raise self._already_running(symbol, each.job)
            return await self.commands.run(symbol, arguments, listener, started, priority)
        declared = self._needs.declared(symbol)
        taken = declared.arguments.check(arguments, f"command {symbol}")
        claim = self._line.claim(Command(NO_NUMBER, symbol, taken))
        self._line.require_taken(claim)
        keepers = self._line.keepers(claim)
        if keepers and declared.busy is Busy.REFUSE:
            first = keepers[0][0].command
            if first.symbol == symbol:
                raise self._already_running(symbol, self.commands.get(first.id).job)
            raise StateError(f"{reason(claim, keepers)}; ask again when it has ended", command=symbol)
        if len(self._line.waiting()) + len(self._line.coming()) >= MOST_WAITING:
            raise StateError(f"{MOST_WAITING} commands wait already; {symbol} is not taken", command=symbol)
        return await self.commands.run(symbol, taken, listener, started, declared.priority + priority)

    def _already_running(self, symbol: str, running: Job) -> StateError:
        net = self._needs.declared_by(symbol) if symbol in self._needs else ""
        work = next((job for job in self._jobs_of(net) if job.command.id == running.command.id), running)
        standing = self._standing[symbol](work) if symbol in self._standing else "begun"
        return StateError(f"{symbol} is already running ({standing}); ask again when it has ended", command=symbol)

    def _jobs_of(self, net: str) -> list[Job]:
        return self.exchange.nets[net].jobs() if net in self.exchange.nets else []

    async def _calibrate_camera(
        self, request: CalibrateCamera.Request, response: CalibrateCamera.Response
    ) -> CalibrateCamera.Response:
        try:
            arguments: dict[str, object] = {
                "cameras": list(request.cameras),
                "poses_file": request.poses_file,
                "accuracy": request.accuracy,
            }
            if request.target:
                arguments["target"] = request.target
            outcome = await self._run(calibrate_camera.SYMBOL, arguments)
            response.success = outcome.success
            response.message = str(outcome.results.get("message", outcome.status.message))
            if outcome.success:
                report = outcome.results["report"]
                assert isinstance(report, Mapping)
                filled(response.report, report_fields(report), "report")
                response.report.directory = str(outcome.results["directory"])
                left = str(outcome.results.get("message", ""))
                response.message = "; but ".join(filter(None, (response.report.message, left)))
        except ImError as error:
            response.success, response.message = False, error.message
        return response

    async def _load_net(self, request: LoadNet.Request, response: LoadNet.Response) -> LoadNet.Response:
        try:
            if bool(request.net_yaml) == bool(request.net_file):
                raise ArgumentError("load_net needs either net_file or net_yaml")
            if len(request.included) != len(request.included_yaml):
                paths, texts = len(request.included), len(request.included_yaml)
                raise ArgumentError(f"load_net needs a text for each path: included has {paths}, included_yaml {texts}")
            require_wait(request.wait)
            if request.net_yaml:
                sent = dict(zip(request.included, request.included_yaml, strict=True))
                net = await run_in_thread(self, parse_sent_net, request.net_yaml, sent, timeout_s=READ_S)
            else:
                net = await run_in_thread(self, load_named_net, request.net_file, timeout_s=READ_S)
            report = await self.load_net(net, request.wait)
        except ImError as error:
            response.success, response.message = False, error.message
            response.counterexample = [str(step) for step in getattr(error, "sequence", ())]
            return response
        response.success = True
        response.message = f"net {net.name} is live: {report.states} markings, bounded, never stuck"
        for name, former in self.exchange.nets.items():
            if former.written.former == net.name:
                begun = ", ".join(f"{job.symbol} (number {job.command.id})" for job in former.jobs())
                response.message += f"; {begun} goes on in its former version, {name}"
        return response

    async def _unload_net(self, request: UnloadNet.Request, response: UnloadNet.Response) -> UnloadNet.Response:
        try:
            require_wait(request.wait)
            await self.unload_net(request.net, request.wait)
        except ImError as error:
            response.success, response.message = False, error.message
            return response
        response.success, response.message = True, f"net {request.net} is gone, with its commands"
        return response


def require_wait(seconds: float) -> None:
    """Check the wait of a client for the rest of a net.

    Raises:
        ArgumentError: It is no time.
    """
    if not 0.0 <= seconds <= LONGEST_WAIT_S:
        raise ArgumentError(f"wait is {seconds:g} s; 0 to {LONGEST_WAIT_S:g} s are allowed")


def note_firing(times: Iterable[StepTimes], message: Firing) -> None:
    """Add a firing to the times of its command."""
    if not 0.0 <= message.duration < math.inf:
        return  # no node of ours says that, and JSON cannot carry a number that is none
    name = f"{message.net}.{message.transition}"
    stamp = message.stamp.sec + message.stamp.nanosec * 1e-9
    for each in times:
        if not each.is_step(message.net, message.transition):
            continue
        if message.phase == Firing.START:
            each.note_start(name, message.command_id, stamp)
        elif message.phase in (Firing.END, Firing.FAILED):
            each.note_end(name, message.command_id, stamp, message.duration)


def dispatcher_functions(host: Host) -> Functions:
    """Return the functions of commands and cell, for a re-run of the nets of a mission."""
    made = joined(command.functions(host, StepTimes()) for command in installed())
    needs = Needs([net for net in host.nets() if not net.former and net.name != cell.NAME], resources_of(load_cell()))
    made.guards.update(WaitingLine(needs, lambda: host.executor(cell.NAME)).guards())
    return made


def main() -> None:
    """Run ``/dispatcher``."""
    sys.exit(run.main(Dispatcher))


if __name__ == "__main__":
    main()
