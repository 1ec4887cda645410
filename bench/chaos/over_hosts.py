"""Faults between hosts: a cut link, frames that are lost and late, a host that dies, an agent without its link."""

import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from bench.chaos import history
from bench.chaos.command import Command
from bench.chaos.faults import Fault
from bench.chaos.hosts import Host, Network, connected
from bench.chaos.records import Result, Verdict
from bench.chaos.switch import Weather
from bench.chaos.trial import HANG_S, judge, next_success
from im_core import clock, names
from im_core.config import package_file
from im_core.errors import ImError, StateError
from im_core.message_paths import MORE_FOLDERS

#: Deployments by the number of their hosts, and the names of these; the first has the cell and gets the commands.
DEPLOYMENTS: Mapping[int, tuple[str, tuple[str, ...]]] = {
    1: ("default.yaml", ("localhost",)),
    2: ("two_hosts.yaml", ("localhost", "coordination")),
    3: ("three_hosts.yaml", ("localhost", "coordination", "display")),
}
CUT_S, LINK_DOWN_S, WEATHER_S = 20.0, 10.0, 20.0
START_S = 400.0
_START = (sys.executable, "-m", "im_bringup.machine.start")
_LISTED = re.compile(r"(\S+) \S+ version (\d+) ")
#: What a true reason names: hosts, and what runs on the other side of a link.
_WORDS = (
    "host", "coordination", "dispatcher", "coordinator", "dom", "mcs", "vss", "testbed", "heard", "missing", "silent",
    "began anew", "begun anew", "doubt", "died and was restarted", "stood still",
)  # fmt: skip


@dataclass
class Machine:
    """A machine over hosts.

    Attributes:
        network: The hosts.
        host_names: Of the hosts in the deployment.
        deployment: Its file.
        events: File with what servers of the first host did.
        agents: Of the other hosts.
        told: What the start has said.
    """

    network: Network
    host_names: tuple[str, ...]
    deployment: Path
    events: Path
    agents: dict[str, subprocess.Popen[str]] = field(default_factory=dict)
    told: str = ""

    @property
    def first(self) -> Host:
        """The host with the cell."""
        return self.network.hosts[0]

    def host(self, name: str) -> Host:
        """The host of a name."""
        return self.network.hosts[self.host_names.index(name)]

    def start_agent(self, name: str) -> None:
        """Start the agent of a host."""
        # the hosts have one disk here: what a client hands over on one is there on each
        shared = {MORE_FOLDERS: str(names.run_dir())}
        self.agents[name] = self.host(name).start(*_START, self.deployment, "--host", name, **shared)

    def record(self) -> None:
        """Begin to note what servers of the first host do."""
        self.events.touch()
        self.first.start(sys.executable, "-m", "bench.chaos.history", self.events)

    def objects(self) -> dict[str, int]:
        """Versions of the data objects by name."""
        done = self.first.run(sys.executable, "-m", "im_bringup.ros.data_objects", "list")
        return {match[1]: int(match[2]) for line in done.stdout.splitlines() if (match := _LISTED.match(line))}


@contextmanager
def running(count: int, factor: float, folder: Path) -> Iterator[Machine]:
    """A machine over so many hosts, stopped at the end.

    Raises:
        StateError: It does not start.
    """
    file, hosts = DEPLOYMENTS[count]
    shipped = package_file("im_bringup", f"deployments/{file}").read_text(encoding="utf-8")
    with connected(count) as network:
        addresses = ", ".join(f"{name}: {host.address}" for name, host in zip(hosts, network.hosts, strict=True))
        deployment = folder / file
        discovery = f"addresses: {{{addresses}}}\n" if count > 1 else ""
        deployment.write_text(f"{discovery}{shipped}", encoding="utf-8")
        machine = Machine(network, hosts, deployment, folder / "events.jsonl")
        for name in hosts[1:]:
            machine.start_agent(name)
        done = machine.first.run(*_START, deployment, "--factor", factor, "--timeout", START_S)
        if done.returncode != 0:
            raise StateError(f"the machine did not start: {done.stderr.strip()[-500:]}")
        machine.told = done.stdout
        try:
            yield machine
        finally:
            machine.first.run(sys.executable, "-m", "im_bringup.machine.stop")


def _cut(machine: Machine, draw: Random) -> Fault:
    name = draw.choice(machine.host_names[1:])

    def inject(_: Callable[[], None]) -> None:
        machine.host(name).cable(up=False)
        clock.sleep(CUT_S)
        machine.host(name).cable(up=True)

    return Fault(f"link cut for {CUT_S:g} s", (name,), inject, _WORDS)


def _weather(machine: Machine, draw: Random) -> Fault:
    weather = Weather(draw.choice((0.02, 0.1)), draw.choice((0.1, 0.3)), draw.choice((0.02, 0.2)))

    def inject(_: Callable[[], None]) -> None:
        machine.network.weather(weather)
        clock.sleep(WEATHER_S)
        machine.network.weather(Weather())

    return Fault("frames lost, late and reordered", (), inject, _WORDS)


def _host_dies(machine: Machine, draw: Random, link_down_s: float = 0.0) -> Fault:
    name = draw.choice(machine.host_names[1:])

    def inject(_: Callable[[], None]) -> None:
        host = machine.host(name)
        host.power_off()
        machine.agents[name].wait()
        clock.sleep(draw.uniform(0.0, 5.0))
        machine.network.replace(host)
        if link_down_s:
            host.cable(up=False)
        machine.start_agent(name)
        if link_down_s:
            clock.sleep(link_down_s)
            host.cable(up=True)

    kind = "host killed, agent begins without its link" if link_down_s else "host killed"
    return Fault(kind, (name,), inject, _WORDS)


def _agent_dies(machine: Machine, draw: Random) -> Fault:
    name = draw.choice(machine.host_names[1:])

    def inject(_: Callable[[], None]) -> None:
        machine.host(name).run(sys.executable, "-c", _KILL, name)

    return Fault("kill -9 of an agent", (name,), inject, _WORDS)


#: Kills the agent of a host, and not its supervisor.
_KILL = """
import os, pathlib, sys
for folder in pathlib.Path("/proc").glob("[0-9]*"):
    words = (folder / "cmdline").read_bytes().split(b"\\0")
    if sys.argv[1].encode() in words and b"--agent" not in words and b"-c" not in words:
        if any(word.endswith(b"/agent") for word in words) and b"im_bringup.machine.supervisor" not in words:
            os.kill(int(folder.name), 9)
"""

KINDS: Mapping[str, Callable[[Machine, Random], Fault]] = {
    "cut": _cut,
    "weather": _weather,
    "host": _host_dies,
    "late": lambda machine, draw: _host_dies(machine, draw, LINK_DOWN_S),
    "agent": _agent_dies,
}


def run(seed: int, machine: Machine, poses: Path, steps: int, duration_s: float, kinds: tuple[str, ...]) -> Result:
    """One injection, and the recovery from it; arguments as of :class:`bench.chaos.trial.Setting`."""
    draw = Random(seed)
    fault = KINDS[draw.choice(kinds)](machine, draw)
    step, later_s = draw.randrange(steps), draw.uniform(0.0, 0.5)
    command = Command(poses, host=machine.first)
    command.await_step(step, HANG_S)
    clock.sleep(later_s)
    try:
        fault.inject(lambda: None)
    except ImError as error:
        return Result(seed, 0.0, fault.kind, str(fault), Verdict.LOST, error.message, None)
    injected = clock.monotonic()
    outcome = command.outcome(HANG_S)
    again, said = next_success(poses, machine.first)
    if again is None:
        verdict, recovery_s = Verdict.LOST, None
    else:
        verdict = judge(fault, outcome)
        recovery_s = max(0.0, again.ended - max(injected, outcome.ended) - duration_s)
    if broken := list(history.faults(history.read(machine.events), machine.objects())):
        verdict, said = Verdict.FALSE, [*said, *broken[:3]]
    return Result(seed, 0.0, fault.kind, str(fault), verdict, "; then: ".join([outcome.said, *said]), recovery_s)
