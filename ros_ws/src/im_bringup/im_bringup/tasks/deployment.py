"""The deployment file: which task runs in which process on which host."""

import argparse
import json
import os
import re
import socket
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import pydantic

from im_bringup.tasks.memory_limit import DEFAULT_MIB
from im_bringup.tasks.upkeep import Keep
from im_core import config
from im_core.config import FieldError, Model
from im_core.errors import ConfigError, DataError, NotFoundError, nearest
from im_core.names import CELL
from im_core.text.bounded_json import read_json

Scalar = bool | int | float | str


def _parameter(value: object, check: pydantic.ValidatorFunctionWrapHandler) -> object:
    try:
        return check(value)
    except pydantic.ValidationError as error:
        raise ValueError("a parameter is a text, a finite number, true or false, or a list of these") from error


ParameterValue = Annotated[Scalar | list[Scalar], pydantic.WrapValidator(_parameter)]
Name = Annotated[str, pydantic.StringConstraints(pattern=r"^[a-z][a-z0-9_]*$", max_length=64)]
HostName = Annotated[str, pydantic.StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=253)]
Address = Annotated[str, pydantic.StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]*$", max_length=253)]
NodeName = Annotated[str, pydantic.StringConstraints(pattern=r"^/[a-z][a-z0-9_]*$", max_length=65)]

MOST_TASKS = 100
"""Of a machine."""

_VALUES = ("clock_factor", "period", "seed", "perfect_arm", "port", "control", "calibration", "commands")
_REFERENCE = re.compile(r"\$\{(\w+)\}")
#: What stands where a reference could: to its brace, or to the end.
_WRITTEN = re.compile(r"\$\{[^}]*\}?")
#: Processes of the machine itself, by the names of their logs, and its node.
_OWN_PROCESSES = ("bootstrap", "verification", "foxglove_bridge")
_OWN_NODE = "/bootstrap"
#: The task that a port for Foxglove adds, in a process of its own, and its package.
_BRIDGE, _BRIDGE_PACKAGE = "foxglove_bridge", "im_bag"
_TESTBED = ("im_sim", "testbed")
#: Executables whose shipped configurations reach the testbed by shared memory -> parameter that names another one.
_SHARES_MEMORY = {("im_mcs", "mcs"): "config", ("im_vss", "vss"): "settings"}
_NO_COMMA = "a comma is not allowed in the name of a command: it separates the commands"


def _without_comma(command: str) -> str:
    if "," in command:
        raise ValueError(_NO_COMMA)
    return command


class Task(Model):
    """Task: executable and given values.

    Attributes:
        package: ROS package of the executable.
        executable: Its console script.
        node: Fully qualified name of the node, ``/`` and the task's name.
        needs: Parts that the cell must have, or kinds of parts, as ``lights``; else the task is left out.
        parameters: ROS parameters; ``${clock_factor}``, ``${period}``, ``${seed}``, ``${perfect_arm}``, ``${port}``,
            ``${control}``, ``${calibration}`` and ``${commands}`` stand for those of the deployment, in lists, too.
    """

    package: Name
    executable: Name
    node: NodeName
    needs: tuple[str, ...] = ()
    parameters: dict[str, ParameterValue] = pydantic.Field(default_factory=dict)

    def texts(self) -> Iterator[tuple[str, str]]:
        """Yield the texts among the parameters, also texts in lists, each with the parameter's name."""
        for parameter, value in self.parameters.items():
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, str):
                    yield parameter, one

    def takes(self, variable: str) -> bool:
        """Whether a parameter refers to a value of the deployment."""
        return any(variable in _REFERENCE.findall(text) for _, text in self.texts())


@dataclass(frozen=True)
class PlacedTask:
    """Task and place: unique id, symbolic name, host and process."""

    id: int
    name: str
    host: str
    process: str
    task: Task


def _misplaced(name: str, task: Task, place: str, names: Mapping[str, str], own: Mapping[str, str]) -> str:
    """Return the reason against a task at a place; empty if there is none."""
    if name in names:
        return f"task '{name}' is in {names[name]} and in {place}"
    if task.node in own:
        return f"task '{name}' has the node {task.node}, which is {own[task.node]}"
    if task.node != f"/{name}":
        return f"task '{name}' has the node {task.node}, which must be /{name}"
    return ""


def _runs_twice(tasks: Mapping[str, Task]) -> str:
    """Return the reason against one executable for two tasks of a process: both nodes would get one name."""
    runs: dict[tuple[str, str], str] = {}
    for name, task in tasks.items():
        other = runs.setdefault((task.package, task.executable), name)
        if other != name:
            return (
                f"tasks '{other}' and '{name}' of one process run the same executable, {task.executable} of "
                f"{task.package}; give each a process of its own"
            )
    return ""


class Deployment(Model):
    """All tasks of a machine.

    Attributes:
        clock_factor: Simulated seconds a second of wall time; 0: as fast as it goes.
        period: Of servo and testbed [s].
        seed: Seed of everything drawn at random.
        perfect_arm: Whether the simulated arms are as drawn; else the tool is off by 0.3 to 1 mm.
        port: TCP port of the display; the next free one is taken where it is in use.
        foxglove: TCP port that Foxglove connects to, which adds a bridge as a process of the first host; 0: none.
        control: Whether the display may operate nets; if not, it only shows them.
        cell: File of the cell, for all tasks, as read from a file relative to it, or the name of a shipped one; empty:
            the default one.
        calibration: Folder of the calibrations to start with, as read from a file relative to it; empty: none, cameras
            and laser scanner are as drawn.
        unproved: Whether it may start where it cannot be decided in time whether its nets may run.
        commands: The commands of the Dispatcher: names of those shipped, net files and folders of them, as read from a
            file relative to it.
        keep: What is kept of logs and results.
        memory_mib: How much memory each process may have before it is ended and started again [MiB].
        addresses: Host name -> its address in the network of the hosts, for discovery without multicast; all hosts or
            none.
        hosts: Host name -> process name -> task name -> task, in starting order. The tasks of one process share its
            interpreter, its DDS participant and its loop, and die and start together.
    """

    clock_factor: Annotated[float, pydantic.Field(ge=0.0, le=100.0)] = 1.0
    period: Annotated[float, pydantic.Field(ge=0.0005, le=0.02)] = 0.0045
    seed: Annotated[int, pydantic.Field(ge=0, le=2**31 - 1)] = 1
    perfect_arm: bool = False
    port: Annotated[int, pydantic.Field(ge=1024, le=65535)] = 8080
    foxglove: Annotated[int, pydantic.Field(ge=0, le=65535)] = 0
    control: bool = False
    cell: str = ""
    calibration: str = ""
    commands: tuple[
        Annotated[
            str, pydantic.StringConstraints(min_length=1, max_length=4096), pydantic.AfterValidator(_without_comma)
        ],
        ...,
    ] = ()
    unproved: bool = False
    keep: Keep = Keep()
    memory_mib: Annotated[int, pydantic.Field(ge=512, le=2**20)] = DEFAULT_MIB
    addresses: dict[HostName, Address] = pydantic.Field(default_factory=dict)
    hosts: Annotated[dict[HostName, dict[Name, dict[Name, Task]]], pydantic.Field(min_length=1)]

    @pydantic.model_validator(mode="after")
    def _check_tasks(self) -> Self:
        count = sum(len(tasks) for processes in self.hosts.values() for tasks in processes.values())
        if count > MOST_TASKS:
            raise ValueError(f"the deployment has {count} tasks; at most {MOST_TASKS} are allowed")
        own = self._own_nodes()
        names: dict[str, str] = {}
        for host, processes in self.hosts.items():
            if not processes:
                raise FieldError(("hosts", host), f"host '{host}' has no process")
            for process, tasks in processes.items():
                here, place = ("hosts", host, process), f"process '{process}' of host '{host}'"
                if not tasks:
                    raise FieldError(here, f"{place} has no task")
                if process in _OWN_PROCESSES:
                    raise FieldError(here, f"{place}: this name is reserved for the machine; choose another")
                if sentence := _runs_twice(tasks):
                    raise FieldError(here, sentence)
                for name, task in tasks.items():
                    if sentence := _misplaced(name, task, place, names, own) or self._wrong_parameter(name, task):
                        raise FieldError((*here, name), sentence)
                    names[name] = place
        self._check_shared_memory()
        self._check_addresses()
        return self

    def _own_nodes(self) -> dict[str, str]:
        """Return the nodes of the machine itself, with the owners; refuse two hosts with one name for both agents."""
        own = {_OWN_NODE: "the machine's own"}
        for host in self.hosts:
            node = f"/{agent_name(host)}"
            if node in own:
                raise FieldError(("hosts", host), f"node {node} is {own[node]}, and that of host '{host}'; rename one")
            own[node] = f"the agent of host '{host}'"
        return own

    def _check_addresses(self) -> None:
        """Refuse addresses of unknown hosts, and hosts without an address of their own where others have one."""
        hosts: dict[str, str] = {}
        for host, address in self.addresses.items():
            here = ("addresses", host)
            if host not in self.hosts:
                raise FieldError(here, f"there is no host '{host}'{nearest(host, self.hosts)}")
            if other := hosts.get(address):
                raise FieldError(here, f"{address} is the address of host '{other}'")
            if address == "localhost" or address.startswith("127."):
                raise FieldError(here, f"{address} means each host itself; give the address at which others reach it")
            hosts[address] = host
        if self.addresses and (without := [host for host in self.hosts if host not in self.addresses]):
            raise FieldError(("addresses",), f"host '{without[0]}' has no address; give one to every host, or to none")

    def _check_shared_memory(self) -> None:
        """Refuse tasks on another host than the testbed with which they share memory."""
        executables = {(placed.task.package, placed.task.executable): placed for placed in self.tasks()}
        testbed = executables.get(_TESTBED)
        for executable, own in _SHARES_MEMORY.items():
            placed = executables.get(executable)
            if testbed is None or placed is None or placed.host == testbed.host or placed.task.parameters.get(own):
                continue
            raise FieldError(
                ("hosts", placed.host, placed.process, placed.name),
                f"task '{placed.name}' is on host '{placed.host}' and the testbed on '{testbed.host}': they meet in "
                "shared memory, which no network carries; put both on one host, or give the task a configuration of "
                f"other hardware by the parameter '{own}'",
            )

    def _wrong_parameter(self, name: str, task: Task) -> str:
        """Return the fault of a parameter of a task: an unknown reference, a mixed list; empty if there is none."""
        known = sorted(self._variables())
        for parameter, text in task.texts():
            for written in _WRITTEN.findall(text):
                if written[2:-1] not in known or not written.endswith("}"):
                    return (
                        f"parameter '{parameter}' of task '{name}' refers to '{written[:60]}'; "
                        f"known are {', '.join(known)}"
                    )
        for parameter, value in self.parameters_of(task).items():
            kinds = sorted({type(one).__name__ for one in value}) if isinstance(value, list) else []
            if len(kinds) > 1:
                return (
                    f"parameter '{parameter}' of task '{name}' is a list of {' and '.join(kinds)}; ROS takes one type"
                )
        return ""

    def _variables(self) -> dict[str, Scalar]:
        values = {name: getattr(self, name) for name in _VALUES}
        return {**values, "commands": ",".join(self.commands)}

    def tasks(self) -> Iterator[PlacedTask]:
        """Yield all tasks with places, in starting order; ids count from 1."""
        number = 0
        for host, processes in self.hosts.items():
            for process, tasks in processes.items():
                for name, task in tasks.items():
                    number += 1
                    yield PlacedTask(number, name, host, process, task)
        if self.foxglove:
            parameters: dict[str, ParameterValue] = {"port": self.foxglove, "introspection": "off"}
            bridge = Task(package=_BRIDGE_PACKAGE, executable=_BRIDGE, node=f"/{_BRIDGE}", parameters=parameters)
            yield PlacedTask(number + 1, _BRIDGE, next(iter(self.hosts)), _BRIDGE, bridge)

    def on_host(self, host: str) -> dict[str, list[PlacedTask]]:
        """The tasks of each process of one host, in starting order.

        Raises:
            NotFoundError: The deployment has no such host.
        """
        if host not in self.hosts:
            raise NotFoundError(kind="host of the deployment", name=host, known=self.hosts)
        processes: dict[str, list[PlacedTask]] = {process: [] for process in self.hosts[host]}
        for placed in self.tasks():
            if placed.host == host:
                processes.setdefault(placed.process, []).append(placed)
        return processes

    def local_host(self) -> str:
        """Return the host of the process: the computer's name if the deployment has one, else ``localhost``."""
        name = socket.gethostname()
        return name if name in self.hosts else "localhost"

    def parameters_of(self, task: Task) -> dict[str, ParameterValue]:
        """Return the ROS parameters of a task: references replaced, parameters missing in the file set to defaults."""
        values: dict[str, ParameterValue] = {"use_sim_time": True, "introspection": "contents"}
        for name, value in task.parameters.items():
            values[name] = [self._resolved(one) for one in value] if isinstance(value, list) else self._resolved(value)
        return values

    def _resolved(self, value: Scalar) -> Scalar:
        if not isinstance(value, str):
            return value
        variables = self._variables()
        whole = _REFERENCE.fullmatch(value)
        if whole is not None:
            return variables[whole.group(1)]
        return _REFERENCE.sub(lambda match: str(variables[match.group(1)]), value)

    def with_values(self, **given: object) -> "Deployment":
        """Return the same deployment with some fields replaced; None leaves a field unchanged.

        Raises:
            ConfigError: A value is out of range.
        """
        changed = {name: value for name, value in given.items() if value is not None}
        try:
            return Deployment.model_validate({**self.model_dump(), **changed})
        except pydantic.ValidationError as error:
            fault = config.faults(error, Deployment)[0]
            shown = f"{fault.value:g}" if isinstance(fault.value, float) else fault.value
            raise ConfigError(f"{fault.field}: {shown}: {fault.words}", field=fault.field) from error


def _require_cell(path: Path, cell: str) -> None:
    """Refuse a deployment file whose cell is neither a file nor shipped."""
    from im_cell.robot import cell_file  # half a second that few starts need

    try:
        there = cell_file(cell).is_file()
    except ConfigError as error:
        raise config.fault_in(path, ("cell",), error.message) from error
    if not there:
        raise config.fault_in(path, ("cell",), f"{cell}: there is no such file")


EVERYWHERE = ("clock_factor", "seed", "perfect_arm", "port", "period", "control", "unproved", "foxglove")
"""Fields that options of ``start`` give, and that mean the same on every host."""
HERE = (*EVERYWHERE, "calibration", "cell")
"""All fields that options of ``start`` give."""


def with_options(deployment: Deployment, options: argparse.Namespace) -> Deployment:
    """Return the deployment with values of a command line, for its cell; errors as of ``with_values``.

    Raises:
        ConfigError: Also: its cell is missing or wrong, or no task is left.
    """
    given = {name: getattr(options, name) for name in HERE if name != "clock_factor"}
    return _for_its_cell(deployment.with_values(clock_factor=options.factor, **given))


def _for_its_cell(deployment: Deployment) -> Deployment:
    named = deployment.cell or os.environ.get(CELL)
    return for_cell(deployment, load_parts(named)) if named else deployment


def load_parts(cell: str) -> tuple[str, ...]:
    """Return the names of the parts of a cell that tasks may need.

    Raises:
        ConfigError: It is missing or wrong.
    """
    from im_cell.robot import load_cell  # half a second that few starts need

    return load_cell(cell).parts


def left_out(deployment: Deployment, parts: Collection[str]) -> dict[str, list[str]]:
    """Return the tasks that a cell with some parts cannot have, with the parts that each lacks."""
    lack = {placed.name: [need for need in placed.task.needs if need not in parts] for placed in deployment.tasks()}
    return {name: needs for name, needs in lack.items() if needs}


def for_cell(deployment: Deployment, parts: Collection[str]) -> Deployment:
    """Return the deployment without the tasks that need other parts than a cell has.

    Raises:
        ConfigError: No task is left.
    """
    out = left_out(deployment, parts)
    hosts = {
        host: {
            process: kept
            for process, tasks in processes.items()
            if (kept := {name: task for name, task in tasks.items() if name not in out})
        }
        for host, processes in deployment.hosts.items()
    }
    if not any(hosts.values()):
        raise ConfigError(f"no task of the deployment can work in the cell: {', '.join(out)} need what it lacks")
    return deployment.model_copy(update={"hosts": hosts})


def options_text(deployment: Deployment, fields: Sequence[str] = EVERYWHERE) -> str:
    """Return the options of ``start`` as JSON, for the bootstrap, or for its message to the agents of other hosts."""
    return json.dumps({name: getattr(deployment, name) for name in fields})


def with_options_text(deployment: Deployment, text: str, fields: Sequence[str] = EVERYWHERE) -> Deployment:
    """Return the deployment with the options told by ``start``, or by the bootstrap.

    Raises:
        DataError: It is no JSON with these options.
        ConfigError: A value is out of range.
    """
    told = read_json(dict[str, Any], text, "the options of the start")
    if told.keys() != set(fields):
        raise DataError(f"the options of the start are {text[:200]}; needed are {', '.join(fields)}")
    return _for_its_cell(deployment.with_values(**told))  # it checks them


def require_calibration_here(deployment: Deployment, folder: str | None) -> None:
    """Refuse a calibration folder to be read by a task on another host.

    Args:
        deployment: The deployment.
        folder: As ``start`` is given it, on this host; None: it is not.

    Raises:
        ConfigError: A task on another host would read it.
    """
    here = deployment.local_host()
    for placed in deployment.tasks() if folder is not None else ():
        if placed.host != here and placed.task.takes("calibration"):
            raise ConfigError(
                f"--calibration {folder} is a folder of this host, and task '{placed.name}', which reads it, is on "
                f"host '{placed.host}': name one of that host as `calibration` in its deployment file",
                field="calibration",
            )


def agent_name(host: str) -> str:
    """Return the name of the agent node of a host."""
    return "agent_" + re.sub(r"\W", "_", host)


def is_name(text: str) -> bool:
    """Return whether a text names something shipped, and no file."""
    return "/" not in text and "." not in text


def default_path() -> Path:
    """Return the path of the default deployment of ``scripts/start.sh``."""
    return config.package_file("im_bringup", "deployments/default.yaml")


def load(path: str | Path) -> Deployment:
    """Read a deployment file; cell, folder of calibrations and net files are relative to the deployment file.

    Raises:
        ConfigError: It cannot be read or is not a deployment, or there is no such cell; names file, line and field.
    """
    deployment = config.load_model(path, Deployment)
    here = Path(path).resolve().parent
    named = [name if is_name(name) else str((here / name).resolve()) for name in deployment.commands]
    for rank, name in enumerate(named):
        if "," in name:
            raise config.fault_in(Path(path), ("commands", rank), f"{name}: {_NO_COMMA}")
    cell = deployment.cell if is_name(deployment.cell) else str((here / deployment.cell).resolve())
    if cell:
        _require_cell(Path(path), cell)
    calibration = deployment.calibration and str((here / deployment.calibration).resolve())
    return deployment.model_copy(update={"commands": tuple(named), "cell": cell, "calibration": calibration})
