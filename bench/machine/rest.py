"""What a start costs, and what the machine uses while nobody wants anything; how often it tells of a command."""

import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from bench.figures import Line
from bench.machine.command import Bench, cpu_by_process
from bench.usage import ended_children_s, memory_mib
from im_bringup.machine import leftovers, stop
from im_core import clock
from im_core.errors import StateError
from im_core.ros import qos
from im_core.ros.run import Spinner

_START = Path(__file__).resolve().parents[2] / "scripts" / "start.sh"
#: How long after its start the machine is looked at, and for how long [s].
_SETTLED_S, _LOOKED_S = 10.0, 20.0
#: CPU time and wall time of a start [s], processors in use at rest by clock factor, memory at rest [MiB], and rate of
#: topics in testbed time [Hz].
_START_CPU_S, _READY_S, _RESTING, _MEMORY_MIB, _RATE_HZ = 8.0, 5.0, {1.0: 0.25, 0.0: 0.05}, 1.1 * 1024, 30.0


class _Listener(Bench):
    """Commands the machine, and hears when its joints and frames were told to be where."""

    def __init__(self) -> None:
        super().__init__()
        self.stamps: dict[str, list[float]] = {"/joint_states": [], "/tf": []}
        self.create_subscription(
            JointState, "/joint_states", lambda told: self._keep_stamp("/joint_states", told), qos.EVENTS
        )
        self.create_subscription(TFMessage, "/tf", lambda told: self._keep_stamp("/tf", told.transforms[0]), qos.EVENTS)

    def _keep_stamp(self, topic: str, stamped: Any) -> None:
        stamp = stamped.header.stamp
        self.stamps[topic].append(stamp.sec + 1e-9 * stamp.nanosec)


def rest_lines(seed: int, port: int) -> list[Line]:
    """Start the machine in real time and as fast as it goes, let it rest, and listen to a command.

    Raises:
        ImError: It does not start, or the command fails.
    """
    return [
        *_started(1.0, seed, port, list),
        *_started(0.0, seed, port, _rate_lines),
    ]


def _started(factor: float, seed: int, port: int, more: Callable[[], list[Line]]) -> list[Line]:
    """The figures of one start and of the rest behind it, then more; the machine is stopped in the end."""
    words = [str(_START), "--factor", f"{factor:g}", "--seed", str(seed), "--port", str(port)]
    try:
        began = clock.monotonic()
        used = _run(words)
        ready_s = clock.monotonic() - began
        used += sum(cpu_by_process().values())
        used += sum(ended_children_s(process.pid) for process in leftovers.processes())
        clock.sleep(_SETTLED_S)
        resting = cpu_by_process()
        clock.sleep(_LOOKED_S)
        spent = sum(now - resting.get(pid, 0.0) for pid, now in cpu_by_process().items()) / _LOOKED_S
        memory = memory_mib(process.pid for process in leftovers.processes())
        name = f"at clock factor {factor:g}"
        return [
            Line(f"scripts/start.sh {name}", ready_s, "s", bar=_READY_S),
            Line("  CPU time of all processes until ready", used, "s", bar=_START_CPU_S),
            Line(f"at rest {name}: processors in use", spent, "", bar=_RESTING[factor]),
            Line("  memory", memory, "MiB", bar=_MEMORY_MIB),
            *more(),
        ]
    finally:
        stop.stop(say=lambda _: None)


def _run(words: list[str]) -> float:
    """CPU time of a program, and of what it has begun and waited for [s].

    Raises:
        StateError: It fails.
    """
    with tempfile.TemporaryFile("w+") as told:
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=told)
        _, status, used = os.wait4(process.pid, 0)  # it gives up by itself
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            told.seek(0)
            raise StateError(f"{' '.join(words)} ended with {process.returncode}: {told.read().strip()[-300:]}")
    return used.ru_utime + used.ru_stime


def _rate_lines() -> list[Line]:
    """How often topics were told during a command, in testbed time."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        listener = _Listener()
        with Spinner([listener]):
            listener.command()
    finally:
        rclpy.try_shutdown()
    return [
        Line(f"{topic} during a command", _rate_hz(stamps), "1/s", bar=_RATE_HZ, at_least=True)
        for topic, stamps in listener.stamps.items()
    ]


def _rate_hz(stamps: list[float]) -> float | None:
    """Messages a second of their own time; None: there were none to tell by."""
    lasted = stamps[-1] - stamps[0] if stamps else 0.0
    return (len(stamps) - 1) / lasted if lasted > 0.0 else None
