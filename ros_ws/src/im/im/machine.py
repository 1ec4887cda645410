"""The machine as seen by a client."""

import contextlib
import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from std_msgs.msg import String
from std_srvs.srv import Trigger

from im.calibration import Calibration
from im.commands import DISPATCHER, Command, control
from im.connection import EVENTS, PATIENCE_S, Connection
from im.errors import MachineError, require
from im.firings import Firings, KnownNets
from im.groups import Group
from im.heartbeats import Heartbeats, Watch
from im.messages import message_of, number_of
from im.objects import DataObjects
from im.vision import Camera, Position, stereo
from im_core.files import FileError
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState, Firing, McsState
from im_msgs.srv import ListCommands, LoadNet, SetLight, UnloadNet

#: Exit code of `start` for a wrong option, below a usage of several lines.
_USAGE = 2


class CalibrateCamera(Command):
    """Command ``calibrate_camera``: the result is a :class:`im.Calibration`."""

    def _read(self, results: dict[str, Any]) -> Calibration:
        return Calibration.of(results)


class Machine:
    """A running machine; made by :meth:`connect` or :meth:`start`, and a context manager.

    Attributes:
        connection: The connection, for what this class does not do.
        dom: Data objects.

    The groups of joints are attributes too, by the names that the cell gives them: ``machine.arm`` is
    ``machine.group("arm")``.
    """

    def __init__(self, connection: Connection, heartbeats: Heartbeats) -> None:
        """Use :meth:`connect` or :meth:`start`."""
        self.connection, self._heartbeats = connection, heartbeats
        self._begun: list[Command] = []
        self._ends = contextlib.ExitStack()
        self._ends.enter_context(connection)
        self.dom, self._nets = DataObjects(connection), KnownNets(connection)

    @classmethod
    def connect(cls, domain: int | None = None, timeout: float = 10.0, watch: Watch | None = None) -> Self:
        """Connect to a running machine, on the local host or another.

        Args:
            domain: ROS domain; None: ``ROS_DOMAIN_ID``.
            timeout: Longest wait for the machine [s].
            watch: What else is known of the machine on this host.

        Raises:
            UnreachableError: No machine was heard, or its Dispatcher is not ready.
            MachineError: There is no such ROS domain, or the timeout is no time.
        """
        if number_of("timeout", timeout) < 0.0:
            raise MachineError(f"timeout is {timeout:g} s; 0 s or more is needed", "argument")
        connection = Connection(domain)
        try:
            heartbeats = Heartbeats(connection, watch)
            heartbeats.until(DISPATCHER, timeout)
        except BaseException:
            connection.close()
            raise
        return cls(connection, heartbeats)

    @classmethod
    def start(cls, deployment: str = "", domain: int | None = None, **options: object) -> Self:
        """Start a machine on the local host, and connect; the end of the context stops the machine.

        Args:
            deployment: Deployment file; empty: the default.
            domain: ROS domain; None: ``ROS_DOMAIN_ID``.
            **options: As of ``start.sh``: ``factor=0, seed=7, fresh=True``.

        Raises:
            MachineError: The machine did not start; carries what ``start`` printed last.
        """
        environment = {**os.environ, **({} if domain is None else {"ROS_DOMAIN_ID": str(domain)})}
        arguments = [text for name, value in options.items() for text in _option(name, value)]
        done = subprocess.run(
            [_program("im_bringup", "start"), *filter(None, [str(deployment)]), *arguments],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            told = (done.stderr.strip() or done.stdout.strip()).splitlines()
            last = max((number for number, line in enumerate(told) if line.startswith("start: ")), default=0)
            if done.returncode != _USAGE:  # a list may stand below the last sentence, and what led to it above
                last = min(last, len(told) - 5)
            raise MachineError("\n".join(told[max(0, last) :]) or f"start ended with {done.returncode}", "start")
        stop = [_program("im_bringup", "stop")]
        try:
            machine = cls.connect(domain, PATIENCE_S)
        except BaseException:
            subprocess.run(stop, env=environment, capture_output=True, check=False)
            raise
        machine._ends.callback(subprocess.run, stop, env=environment, capture_output=True, check=False)
        return machine

    def close(self) -> None:
        """End the connection, and the machine if started by :meth:`start`."""
        self._ends.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        """Close; after Ctrl-C, cancel the unfinished commands of the client."""
        try:
            if isinstance(error, KeyboardInterrupt):
                for command in self._begun:
                    if not command.ended:
                        with contextlib.suppress(MachineError):
                            command.cancel()
                            command.wait(PATIENCE_S)
        finally:
            self.close()

    @property
    def tasks(self) -> dict[str, int]:
        """Phases of the tasks heard so far, as in ``im_msgs/msg/TaskStatus``."""
        return self._heartbeats.tasks()

    @property
    def state(self) -> McsState:
        """State of motion control: power, groups, owners, the reason of a stop."""
        state: McsState = self.connection.latest(McsState, "/mcs/state")
        return state

    @property
    def commands(self) -> dict[str, Mapping[str, Any]]:
        """Descriptions of the commands by name: ``description``, ``arguments`` (a JSON schema), ``needs``, ..."""
        return self._told()[0]

    @property
    def left_out(self) -> dict[str, str]:
        """Why the cell has no such command: the parts that it lacks, by the command's name."""
        return self._told()[1]

    def _told(self) -> tuple[dict[str, Mapping[str, Any]], dict[str, str]]:
        text = self.connection.latest(String, "/dispatcher/commands").data
        try:
            told = json.loads(text)
            return {command["symbol"]: command for command in told["commands"]}, dict(told.get("left_out", {}))
        except (ValueError, KeyError, TypeError) as error:
            raise MachineError(f"/dispatcher/commands is no list of commands: {text[:60]!r}", "data") from error

    @property
    def under_way(self) -> list[CommandState]:
        """The unfinished commands."""
        return list(self.connection.call(ListCommands, "/dispatcher/list_commands").commands)

    def run(self, name: str, /, wait: bool = True, priority: int = 0, **arguments: object) -> Command:
        """Run a command.

        Args:
            name: Name of the command; see :attr:`commands`.
            wait: Wait for the end, and raise if the command failed.
            priority: -10 to 10, added to the priority of the command.
            **arguments: Arguments of the command.

        Raises:
            MachineError: The command failed or was refused; with ``wait``.
        """
        command: Command = self._follow(Command, self._goal(name, priority, arguments))
        if wait:
            _ = command.result
        return command

    def calibrate_camera(
        self,
        cameras: tuple[str, ...] | list[str] = (),
        poses_file: str = "",
        target: str = "light",
        accuracy: float = 0.0,
    ) -> CalibrateCamera:
        """Begin ``calibrate_camera``; iterate for progress, and ask for the result.

        Args:
            cameras: Names of the cameras; empty: the first two of the cell.
            poses_file: File of poses on the host of the machine; empty: the poses of the cell.
            target: What the arm shows to the cameras: ``light`` or ``board``.
            accuracy: Expected error of a triangulated point, RMS, at which the command ends [m]; 0: after all poses.
        """
        if not isinstance(cameras, list | tuple):
            raise MachineError(f"cameras is {cameras!r:.60}; a list of names is needed, such as ['wall']", "argument")
        arguments: dict[str, object] = {"cameras": list(cameras), "target": target, "accuracy": accuracy}
        if poses_file:
            arguments["poses_file"] = poses_file
        command: CalibrateCamera = self._follow(CalibrateCamera, self._goal("calibrate_camera", 0, arguments))
        return command

    def attach(self, number: int) -> Command:
        """Return a command by number, under way or ended lately."""
        command: Command = self._follow(Command, message_of(ExecuteCommand.Goal, attach=True, command_id=number))
        return command

    @property
    def groups(self) -> dict[str, Group]:
        """The groups of joints of the preset in force, by name."""
        return {status.group: Group(self.connection, status.group) for status in self.state.groups}

    def group(self, name: str) -> Group:
        """Return a group of the preset in force.

        Raises:
            MachineError: There is no such group.
        """
        groups = self.groups
        if name not in groups:
            known = ", ".join(groups)
            raise MachineError(f"there is no group '{name}'; there are {known}", "not_found", {"group": name})
        return groups[name]

    def __getattr__(self, name: str) -> Group:
        """Return the group of the name.

        Raises:
            AttributeError: There is no such group.
        """
        if name.startswith("_"):  # asked by copies, notebooks and debuggers
            raise AttributeError(name)
        try:
            return self.group(name)
        except MachineError as error:
            if error.code != "not_found":
                raise
            raise AttributeError(f"a machine has no '{name}': {error.message}") from None

    def __dir__(self) -> list[str]:
        """Complete names by those of the groups."""
        return [*super().__dir__(), *self.groups]

    def camera(self, name: str) -> Camera:
        """Return a camera."""
        return Camera(self.connection, name)

    def stereo(self, first: str, second: str, exposure: float = 0.0) -> Position:
        """Find the light with two cameras exposed at the same time.

        Args:
            first: Name of a camera fixed to the world.
            second: Name of another.
            exposure: Time of exposure [s]; 0: the one of ``/vss``.

        Raises:
            MachineError: No point was found, of code ``not_found``, or an image was not taken.
        """
        return stereo(self.connection, first, second, exposure)

    @contextlib.contextmanager
    def light(self, name: str) -> Iterator[None]:
        """Switch a light on for the context.

        Args:
            name: Name of the light: of an arm's, the group's with ``_led``.

        Raises:
            MachineError: There is no such light.
        """
        self._switch(name, True)
        try:
            yield
        finally:
            self._switch(name, False)

    def estop(self) -> str:
        """Stop everything and take the power; return the report of the hardware.

        Raises:
            MachineError: The stop was not confirmed.
        """
        return self._trigger("/mcs/estop")

    def reset(self) -> str:
        """End an emergency stop without a remaining cause; nothing moves.

        Raises:
            MachineError: The cause is still there.
        """
        return self._trigger("/mcs/reset")

    def load_net(self, net: str | Path, wait: float = 0.0) -> str:
        """Give the Dispatcher a net, live after verification; return the verdict.

        Args:
            net: Path of a net file, sent with the files that it includes, or the text of one (with a line break).
            wait: Longest wait for the present net of the name to come to rest [s].

        Raises:
            MachineError: The file cannot be read, or the net was refused; the firing sequence that shows why is the
                fact ``counterexample``.
        """
        from im.net_files import read_net_file  # YAML is for this alone: programs begin sooner without it

        is_text, longest = "\n" in str(net), number_of("wait", wait)
        try:
            text, included = (str(net), {}) if is_text else read_net_file(net)
        except (FileError, TypeError) as error:
            why = error.message if isinstance(error, FileError) else f"{net!s:.200}: {error}"
            raise MachineError(f"net file {why}", "file") from error
        sent = {"net_yaml": text, "included": list(included), "included_yaml": list(included.values())}
        answer = self.connection.call(LoadNet, "/dispatcher/load_net", PATIENCE_S + longest, wait=longest, **sent)
        if not is_text:  # the Dispatcher knows no name of a text
            answer.message = re.sub(r"(^|(?<= in ))net(?=:\d+:)", lambda _: str(net), answer.message)
        return str(require(answer, "net", counterexample=list(answer.counterexample)).message)

    def unload_net(self, name: str, wait: float = 0.0) -> None:
        """Take a net out of the Dispatcher.

        Args:
            name: Name of the net.
            wait: Longest wait for the net to come to rest [s].

        Raises:
            MachineError: Something keeps the net.
        """
        longest = number_of("wait", wait)
        answer = self.connection.call(UnloadNet, "/dispatcher/unload_net", PATIENCE_S + longest, net=name, wait=longest)
        require(answer, "net")

    @contextlib.contextmanager
    def firings(self, net: str = "") -> Iterator[Firings]:
        """Follow the firings of the nets from now on, for the context.

        Args:
            net: Name of a net; empty: all nets.

        Raises:
            MachineError: There is no such net.
        """
        if net:
            self._nets.require(net)
        firings = Firings(net, self._heartbeats)
        subscription = self.connection.subscribe(Firing, "/pnt/firings", firings.take, EVENTS)
        try:
            yield firings
        finally:
            self.connection.unsubscribe(subscription)

    @contextlib.contextmanager
    def record(self, folder: str | Path) -> Iterator[None]:
        """Record all topics into a bag on the local host, for the context.

        Args:
            folder: Folder of the bag; must not exist.

        Raises:
            MachineError: The recorder failed; carries what it printed.
        """
        environment = {**os.environ, "ROS_DOMAIN_ID": str(self.connection.domain)}
        recorder = subprocess.Popen(
            [_program("im_bag", "record"), "-o", str(folder)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert recorder.stdout is not None
        begun = recorder.stdout.readline()  # said once it records; faults are said on the other stream
        try:
            if begun:
                yield
        finally:
            if begun:
                recorder.send_signal(signal.SIGINT)
            told = recorder.communicate()[1]
        if not begun or recorder.returncode not in (0, 130):
            raise MachineError(told.strip() or f"the recorder ended with {recorder.returncode}", "record")

    def control(self, number: int, request: str) -> str:
        """Cancel, pause, resume or abandon a command by number; return the change.

        Args:
            number: Number of the command.
            request: ``cancel``, ``pause``, ``resume`` or ``abandon``.

        Raises:
            MachineError: The request was refused.
        """
        return control(self.connection, number, request)

    def _goal(self, name: str, priority: int, arguments: Mapping[str, object]) -> ExecuteCommand.Goal:
        for argument, value in arguments.items():
            try:
                json.dumps(value, allow_nan=False, default=_plain)
            except (TypeError, ValueError) as error:
                allowed = "finite numbers, texts, lists and mappings can be sent"
                sentence = f"{name}: argument {argument} is {value!r:.200}; {allowed}"
                raise MachineError(sentence, "argument", {"field": argument}) from error
        text = json.dumps(arguments, default=_plain)
        goal: ExecuteCommand.Goal = message_of(ExecuteCommand.Goal, symbol=name, arguments=text, priority=priority)
        if not -10 <= goal.priority <= 10:
            raise MachineError(f"priority {priority} is not from -10 to 10", "argument")
        return goal

    def _follow(self, kind: Any, goal: ExecuteCommand.Goal) -> Any:
        command = kind(self.connection, self._heartbeats, goal)
        self._begun = [each for each in self._begun if not each.ended]
        if not goal.attach:
            self._begun.append(command)
        return command

    def _switch(self, name: str, on: bool) -> None:
        require(self.connection.call(SetLight, "/testbed/set_light", name=name, on=on), "not_found", light=name)

    def _trigger(self, service: str) -> str:
        return str(require(self.connection.call(Trigger, service)).message)


def _program(package: str, executable: str) -> str:
    """Return the path of an executable of the sourced workspace.

    Raises:
        MachineError: No sourced workspace has it.
    """
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "lib" / package / executable
        if path.is_file():
            return str(path)
    raise MachineError(f"no sourced workspace has {package}/{executable}; source install/setup.bash", "not_found")


def _option(name: str, value: object) -> list[str]:
    option = f"--{name.replace('_', '-')}"
    if isinstance(value, bool):
        return [option] if value else []
    return [option, str(value)]


def _plain(value: object) -> object:
    """Return a numpy value as plain Python, for JSON."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} is no number, text, list or mapping")
