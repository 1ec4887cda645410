"""Hosts that stand for computers: each has a network, processes and shared memory of its own; a switch joins them."""

import array
import fcntl
import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from bench.chaos.switch import Weather
from im_bringup.tasks.middleware import RANGE
from im_core import clock, names
from im_core.errors import StateError, WaitTimeoutError
from im_core.processes.host_record import PROFILE

#: How long a host may take to be there, and a cable to be up [s].
_BOOT_S = 60.0
#: Longest run of a program on a host [s].
PROGRAM_S = 900.0
CABLE = "eth7"
_INIT = "mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo up && while sleep 3600; do :; done"
#: Ask a driver to compute no check sums of frames later (``linux/ethtool.h``): the switch passes on what it gets.
_SIOCETHTOOL, _SET_TX_CHECKSUM = 0x8946, 0x17


class Host:
    """A computer that stands for one, with folders of its own for runs and results."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.power_on()

    def power_on(self) -> None:
        """Start it; nothing runs on it.

        Raises:
            StateError: The system has no namespaces for it.
        """
        argv = ["unshare", "--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc", "sh", "-c", _INIT]
        self._holder = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self._holder.stdout is not None
        assert self._holder.stderr is not None
        if not self._holder.stdout.readline():
            raise StateError(f"no namespaces here: {self._holder.stderr.readline().strip()}")
        children = Path(f"/proc/{self._holder.pid}/task/{self._holder.pid}/children").read_text(encoding="ascii")
        self.pid = int(children.split()[0])

    def power_off(self) -> None:
        """End all that runs on it at once, and lose its shared memory and its cable."""
        self._holder.kill()
        self._holder.communicate()

    def argv(self, *argv: object) -> list[str]:
        """Words that run a program on the host."""
        return ["nsenter", "--target", str(self.pid), "--net", "--mount", "--pid", *map(str, argv)]

    def environment(self, more: Mapping[str, str]) -> dict[str, str]:
        """The environment without what our scripts say of DDS, and with more."""
        ours = (PROFILE, RANGE)
        plain = {key: value for key, value in os.environ.items() if key not in ours}
        own = {"IM_RUN_DIR": str(self.run_dir), "IM_RESULTS_DIR": str(self.run_dir / "results")}
        return {**plain, **own, **more}

    @property
    def run_dir(self) -> Path:
        """Its run folder."""
        folder = names.run_dir() / f"host-{self.address}"
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder

    def run(self, *argv: object, **more: str) -> subprocess.CompletedProcess[str]:
        """Run a program to its end, with more in its environment."""
        return subprocess.run(
            self.argv(*argv),
            env=self.environment(more),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=PROGRAM_S,
        )

    def start(self, *argv: object, **more: str) -> subprocess.Popen[str]:
        """Start a program, which ends with the host at the latest."""
        return subprocess.Popen(
            self.argv(*argv),
            env=self.environment(more),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def cable(self, up: bool) -> None:
        """Plug the cable in, or pull it out."""
        self.run("ip", "link", "set", CABLE, "up" if up else "down")

    def await_cable(self) -> None:
        """Wait for the cable to be up: DDS takes the interfaces that are up when it begins.

        Raises:
            WaitTimeoutError: It is not.
        """
        deadline = clock.monotonic() + _BOOT_S
        while "state UP" not in self.run("ip", "link", "show", CABLE).stdout:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"the cable of {self.address}", seconds=_BOOT_S)
            clock.sleep(0.05)


class Network:
    """Hosts whose cables meet in a switch.

    Args:
        addresses: One for each host, in a network of 256.
    """

    def __init__(self, addresses: Sequence[str]) -> None:
        self._middle = Host("switch")
        self.hosts = [Host(address) for address in addresses]
        self._switch: subprocess.Popen[str] | None = None
        for host in self.hosts:
            self._plug(host)
        self._forward()

    def weather(self, weather: Weather) -> None:
        """Have the switch lose and delay frames."""
        assert self._switch is not None
        assert self._switch.stdin is not None
        self._switch.stdin.write(json.dumps(asdict(weather)) + "\n")
        self._switch.stdin.flush()

    def replace(self, host: Host) -> None:
        """Power a host on again that was powered off, with its cable plugged in."""
        host.power_on()
        self._plug(host)
        self._forward()

    def end(self) -> None:
        """End all that runs on the hosts, and the switch."""
        self._stop_switch()
        for host in (*self.hosts, self._middle):
            host.power_off()

    def _plug(self, host: Host) -> None:
        port = f"port{self.hosts.index(host)}"
        self._middle.run("ip", "link", "delete", port)  # the kernel takes its time with that of a host that was killed
        words = f"ip link add {CABLE} netns {host.pid} type veth peer name {port} netns {self._middle.pid}"
        done = subprocess.run(words.split(), capture_output=True, text=True, check=False)
        if done.returncode:
            raise StateError(f"no network between namespaces here: {done.stderr.strip()}")
        self._middle.run("ip", "link", "set", port, "promisc", "on", "up")
        host.run(sys.executable, "-m", "bench.chaos.hosts")
        host.run("ip", "addr", "add", f"{host.address}/24", "dev", CABLE)
        host.cable(up=True)
        host.await_cable()

    def _forward(self) -> None:
        self._stop_switch()
        argv = (sys.executable, "-m", "bench.chaos.switch", *(f"port{rank}" for rank in range(len(self.hosts))))
        self._switch = subprocess.Popen(
            self._middle.argv(*argv), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._switch.stdout is not None
        if not self._switch.stdout.readline():
            raise StateError("the switch does not work")

    def _stop_switch(self) -> None:
        if self._switch is not None:
            self._switch.communicate()


@contextmanager
def connected(count: int) -> Iterator[Network]:
    """Hosts that reach each other."""
    network = Network([f"10.99.7.{number}" for number in range(1, count + 1)])
    try:
        yield network
    finally:
        network.end()


def send_check_sums() -> None:
    """Have the cable of this host carry whole frames: what comes through a switch of programs is checked."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        data = array.array("B", struct.pack("II", _SET_TX_CHECKSUM, 0))
        request = struct.pack("16sQ16x", CABLE.encode(), data.buffer_info()[0])
        fcntl.ioctl(any_socket.fileno(), _SIOCETHTOOL, request)


if __name__ == "__main__":
    send_check_sums()
