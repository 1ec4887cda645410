"""``pnt_node``: run nets in a separate node, on any robot."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from pathlib import Path

import rclpy
from rclpy.exceptions import InvalidNodeNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_node_name import validate_node_name

from im_core import plugins
from im_core.clock import monotonic
from im_core.errors import ConfigError, ImError, StateError
from im_core.file_lock import FileLock
from im_core.names import run_dir
from im_core.processes.end_signals import heed_end_signals
from im_core.processes.process import ChildProcess
from im_core.ros.calls import pause
from im_core.ros.peers.servers import servers_of
from im_core.ros.run import Spinner
from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt.verification import Verifier
from im_pnt_node.cli.order import Order
from im_pnt_node.ros.commands.commands import CommandOutcome
from im_pnt_node.ros.node import PntNode

_DESCRIPTION = """Verifies nets together and runs them in a node of their own, without the machine: a robot's own nodes
offer services, actions and topics, and the nets call them. docs/tutorials/your_robot.md begins with an empty folder.

  scripts/im pnt run pick.yaml                                   runs the net; action /pick/execute takes commands
  scripts/im pnt run pick.yaml --symbol pick --arg width=0.02    runs one command, tells its steps, and ends
  scripts/im pnt run pick.yaml --symbol pick --journal state     killed by -9? The same line again goes on
  scripts/im pnt run pick.yaml cell.yaml --page                  two nets, and the page that shows them live

Functions that nets name as module:function are looked for beside the net files too. Ctrl-C cancels what runs and
waits for its actions to end, and 5 s more at most; Ctrl-C again ends at once. Parameters of the node follow
--ros-args, as for every node.

Exit code: 0 done, 1 the command failed or the nets are refused, 2 a file, an option or the start went wrong."""

OK, REFUSED, BAD_INPUT = 0, 1, 2
VERIFIER = "im_pnt_analysis:verify_to_load"
PAGE, DOM = "im_pnt_display", "im_dom"
DOM_S = 2.0
"""How long no Data Object Manager may be in the graph before this program starts one [s]."""
PATIENCE_S = 3.0
"""How long cancelled commands may go on without any action under way [s]: the process ends within 5 s."""
_LOOK_S = 0.05


def main(arguments: Sequence[str] | None = None, program: str = "pnt_node") -> int:
    """Run ``pnt_node``.

    Args:
        arguments: Command line without the program's name; None: that of the process.
        program: What it is called in messages.

    Returns:
        Exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    cut = words.index("--ros-args") if "--ros-args" in words else len(words)
    options = _parser(program).parse_args(words[:cut])
    try:
        if options.arg and options.symbol is None:
            raise ConfigError("--arg is an argument of a command: --symbol NAME is missing")
        plugins.find_beside(options.files)
        nets = [load_net(file) for file in options.files]
        order = None if options.symbol is None else Order.read(nets, options.symbol, options.arg)
        verifier: Verifier = plugins.load(VERIFIER, None, "verifier")  # type: ignore[assignment]  # it is one
        verifier(nets).require_ok()
        _check_name(options.name or nets[0].name)
        if options.page and find_spec(PAGE) is None:
            raise ConfigError(f"the page is of the package {PAGE}, which is not installed")
    except ImError as error:
        print(f"{program}: {error.message}", file=sys.stderr)
        return REFUSED if error.code == "net_refused" else BAD_INPUT
    return _run(options, nets, verifier, order, words[cut:])


def _run(
    options: argparse.Namespace, nets: Sequence[Net], verifier: Verifier, order: Order | None, ros: list[str]
) -> int:
    """Spin the node, with the page beside the node, until the request is done."""
    try:
        rclpy.init(args=ros, signal_handler_options=SignalHandlerOptions.NO)
    except (_rclpy.RCLError, _rclpy.UnknownROSArgsError) as error:
        print(f"{' '.join(ros)}: {error}", file=sys.stderr)
        return BAD_INPUT
    with ExitStack() as ends:
        ends.callback(rclpy.try_shutdown)
        if options.page:
            page = ChildProcess.of_module(f"{PAGE}.ros.node", ["--ros-args", "-p", "standalone:=true"])
            ends.callback(page.stop)
        journal = str(Path(options.journal).resolve() / "journal") if options.journal else ""
        given = {"standalone": True, "seed": options.seed, "journal_dir": journal}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        node = RunNode(options.name or nets[0].name, options.files, order, verifier, overrides)
        spinner = Spinner([node])
        ends.callback(spinner.stop)
        ends.callback(node.stop_dom)
        node.finished = spinner.request_stop
        heed_end_signals(lambda _: node.interrupt())
        spinner.spin()
    return node.exit_code


def _check_name(name: str) -> None:
    """Raise the fault in the name of a node."""
    try:
        validate_node_name(name)
    except InvalidNodeNameException as error:
        raise ConfigError(f"'{name}' is no name of a node: {str(error).splitlines()[0]}") from error


class RunNode(PntNode):
    """Node with the nets of a command line, and perhaps one command for the nets.

    Args:
        name: Name of the node.
        files: The net files.
        order: The command; None: clients bring commands.
        verifier: Says whether nets may run together.
        overrides: Parameters.

    Attributes:
        exit_code: That of the process.
        finished: Called when nothing is left to do.
    """

    def __init__(
        self,
        name: str,
        files: Sequence[str],
        order: Order | None,
        verifier: Verifier,
        overrides: list[Parameter],
    ) -> None:
        super().__init__(name, files, verifier=verifier, parameter_overrides=overrides)
        self.exit_code = OK
        self.finished: Callable[[], None] = lambda: None
        self._order = order
        self._ending, self._obeying = False, order is not None
        self._dom: ChildProcess | None = None
        self._began = monotonic()

    def stop_dom(self) -> None:
        """End the Data Object Manager, if started by this node."""
        if self._dom is not None:
            self._dom.stop()

    def phase_start(self) -> None:
        """Start the nets, offer the commands, and begin the requested one."""
        super().phase_start()
        self.offer_commands()
        self._look_for_objects()
        self._name_absent()
        if self._order is not None:
            self.spawn(self._obey(self._order))
        else:
            known = ", ".join(self.commands.symbols()) or "none"
            self.get_logger().info(f"action /{self.task_name}/execute takes commands: {known}")

    def fail(self, error: ImError) -> None:
        """End with the fault of the start."""
        super().fail(error)
        self.exit_code = REFUSED if error.code == "net_refused" else BAD_INPUT
        self.finished()

    def interrupt(self) -> None:
        """Cancel running commands and end afterwards; end at once the second time. From any thread."""
        if self._ending or not self.ready:
            self.finished()
        self._ending = True
        self.spawn(self._wind_down())

    async def _wind_down(self) -> None:
        acted, cancelled = monotonic(), set[int]()
        while (left := [job for executor in self.exchange.nets.values() for job in executor.jobs()]) or self._obeying:
            for job in left:
                if job.is_command and job.command.id not in cancelled:  # it may have begun after the signal
                    cancelled.add(job.command.id)
                    self._tell(f"cancels {job.symbol}; once more ends at once")
                    self.commands.cancel(job.command.id, "cancelled from the keyboard")
            if any(executor.activities for executor in self.exchange.nets.values()):
                acted = monotonic()
            elif monotonic() - acted > PATIENCE_S:
                commands = ", ".join(dict.fromkeys(job.symbol for job in left)) or "the command"
                marked = {net: each.marking().items() for net, each in self.exchange.nets.items()}
                places = " ".join(f"{net}.{place}" for net, places in marked.items() for place, n in places if n)
                self._tell(f"{commands}: no way out of the marking {places}; ends without it")
                self.exit_code = REFUSED
                self.finished()
                return
            await pause(self, _LOOK_S)
        if self._order is None:
            self.finished()

    async def _obey(self, order: Order) -> None:
        self.exit_code = REFUSED  # until it is done
        try:
            while not self.begun:
                await pause(self, _LOOK_S)
            going_on = [each for each in self.commands.open() if each.job.command.symbol == order.symbol]
            same = next((each for each in going_on if each.job.command.arguments == order.arguments), None)
            if same is not None:
                self._tell(f"{order.symbol} goes on where the journal ends")
                outcome = await self.commands.wait(same.job.command.id, self._step)
            else:
                for other in going_on:
                    given, asked = json.dumps(other.job.command.arguments), json.dumps(order.arguments)
                    self._tell(f"{order.symbol} of {given} goes on where the journal ends, and {asked} comes after it")
                outcome = await self.commands.run(order.symbol, order.arguments, self._step)
        except ImError as error:
            self._tell(f"{order.symbol} was not begun: {error.message}")
            self.exit_code = BAD_INPUT
        else:
            self._conclude(order.symbol, outcome)
        finally:
            self._obeying = False
            self.finished()

    def _conclude(self, symbol: str, outcome: CommandOutcome) -> None:
        results = f": {json.dumps(outcome.results)}" if outcome.results else ""
        why = "" if outcome.success else f": {outcome.status.message}"
        self._tell(f"{symbol} {'done' if outcome.success else 'failed'}{why}{results}")
        self.exit_code = OK if outcome.success else REFUSED

    def _step(self, transition: str, text: str, progress: float) -> None:
        share = f"{100.0 * progress:3.0f} %  " if progress >= 0.0 else ""
        self._tell(f"{share}{transition or text}")

    def _tell(self, text: str) -> None:
        print(f"{monotonic() - self._began:8.2f} s  {text}", flush=True)

    def _written(self) -> list[Net]:
        return [executor.written for executor in self.exchange.nets.values()]

    def _name_absent(self) -> None:
        """Warn of nets that other processes must run: the machine reserves nothing for a net outside."""
        partners = {partner for net in self._written() for partner in net.partners()}
        if absent := sorted(partners - self.exchange.nets.keys()):
            told = (
                f"other processes must run {', '.join(absent)}; a running machine holds nothing of 'needs' for this net"
            )
            self.get_logger().warning(f"{told}: scripts/im load gives it the net")

    def _look_for_objects(self) -> None:
        places = [place for net in self._written() for place in net.places.values()]
        names = sorted({place.data_object for place in places if place.data_object is not None})
        if names:
            self.spawn(self._keep_objects(", ".join(names)))

    async def _keep_objects(self, names: str) -> None:
        """Start a Data Object Manager whenever no node answers for the data objects of the nets."""
        found, lock = monotonic(), None
        while lock is None:
            if servers_of(self, "/dom/get"):
                found = monotonic()
            elif monotonic() - found > DOM_S:
                if find_spec(DOM) is None:
                    self.get_logger().warning(f"nobody keeps the data objects {names}: {DOM} is not installed")
                    return
                with suppress(StateError):  # another program does it, and is found soon, or has just ended
                    lock = FileLock(run_dir() / "dom.lock")
            await pause(self, 0.2)
        while True:
            self._tell(f"no machine keeps the data objects {names}: this program does, in {run_dir()}")
            self._dom = ChildProcess.of_module(f"{DOM}.ros.node", ["--ros-args", "-p", "standalone:=true"])
            while self._dom.poll() is None:
                await pause(self, 1.0)


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        program, description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", metavar="NET.yaml", help="net files; they are verified together")
    parser.add_argument("--symbol", metavar="NAME", help="run this command once, and end")
    parser.add_argument(
        "--arg", action="append", default=[], metavar="NAME=VALUE", help="an argument of the command; once for each"
    )
    parser.add_argument("--journal", metavar="DIR", help="folder in which a node that is killed finds where it was")
    parser.add_argument("--page", action="store_true", help="show the nets live on a web page")
    parser.add_argument("--name", metavar="NODE", help="name of the node (that of the first net)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of choices among transitions (0)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
