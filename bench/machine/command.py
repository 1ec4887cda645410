"""The machine started, commanded and stopped: what each takes, and the command against the least it could cost."""

import json
import math
import statistics
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions

from bench.figures import Line
from bench.machine.limit import bare_cost, limit_lines
from bench.machine.truth import get_truth
from bench.usage import cpu_s, memory_mib
from im_bringup.calibration.truth import add_to_report
from im_bringup.machine import leftovers, stop
from im_bringup.machine.start import start
from im_bringup.ros.interruptible import InterruptibleNode
from im_bringup.tasks import deployment as deployments
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import StateError
from im_core.message_paths import hand_over
from im_core.ros import qos
from im_core.ros.run import Spinner
from im_msgs.msg import McsState
from im_msgs.srv import CalibrateCamera

START_S = 240.0
COMMAND_S = 600.0
"""Longest wait for a calibration [s]."""
NODE = "import rclpy; from rclpy.node import Node; rclpy.init(); Node('bare')"


@dataclass(frozen=True)
class Command:
    """A command that was carried out.

    Attributes:
        report: What it reports.
        folder: Where it wrote its results.
        cpu_s: What it cost all processes of the machine [s].
    """

    report: dict[str, Any]
    folder: Path
    cpu_s: float


class Bench(InterruptibleNode):
    """Commands the machine and listens to the servo."""

    def __init__(self) -> None:
        super().__init__("bench")
        self._calibration = self.create_client(CalibrateCamera, "/dispatcher/calibrate_camera")
        self.servo: McsState | None = None
        self.create_subscription(McsState, "/mcs/state", self._keep, qos.LATCHED)

    def _keep(self, message: McsState) -> None:
        self.servo = message

    def command(self, poses: Path | None = None) -> Command:
        """Calibrate the ceiling cameras.

        Args:
            poses: File of the poses; None: the cell's own.

        Raises:
            StateError: The command failed.
        """
        before = cpu_by_process()
        given = str(hand_over(poses)) if poses else ""
        answer = self.ask(self._calibration, CalibrateCamera.Request(poses_file=given), COMMAND_S)
        if not answer.success:
            raise StateError(f"calibrate_camera failed: {answer.message}")
        used = sum(spent - before.get(pid, 0.0) for pid, spent in cpu_by_process().items())
        return Command(json.loads(answer.report.json), Path(answer.report.directory), used)


def cpu_by_process() -> dict[int, float]:
    """CPU time that each process of the machine has used [s]."""
    return {process.pid: cpu_s(process.pid) for process in leftovers.processes()}


def bare_node_s(times: int = 3) -> float:
    """Wall time from nothing to a bare rclpy node, median [s]."""
    return statistics.median(
        seconds(lambda: subprocess.run([sys.executable, "-c", NODE], check=True)) for _ in range(times)
    )


def seconds(function: Callable[[], object]) -> float:
    """Wall time of a call [s]."""
    began = clock.monotonic()
    function()
    return clock.monotonic() - began


def machine_lines(factor: float, seed: int, port: int, runs: int) -> list[Line]:
    """Start the machine, command it, stop it.

    Raises:
        ImError: It does not start, or a command fails.
    """
    path = deployments.default_path()
    deployment = deployments.load(path).with_values(clock_factor=factor, seed=seed, port=port)
    tasks = len(list(deployment.tasks()))
    node_s = bare_node_s()
    began = clock.monotonic()
    if start(deployment, path, START_S) != 0:
        raise StateError("the machine did not start")
    ready_s = clock.monotonic() - began
    lines = [
        Line(f"start, {tasks} tasks ready", ready_s, "s", bar=15.0),
        Line("  against bare nodes", ready_s, "s", tasks * node_s, f"{tasks} bare nodes"),
    ]
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        bench = Bench()
        memory = []
        with Spinner([bench]):
            for number in range(runs):
                print(f"bench: command {number + 1} of {runs}", flush=True)
                command = bench.command()
                memory.append(memory_mib(process.pid for process in leftovers.processes()))
                lines += command_lines(number + 1, factor, command)
            servo = bench.servo
        if factor == 0:
            print("bench: bare physics, bare rendering, the solver", flush=True)
            lines += limit_lines(command.report, bare_cost(command.folder / "observations.json"))
        lines += [
            Line("memory after the last command", memory[-1], "MiB", bar=2560.0),
            Line("  growth since the first", memory[-1], "MiB", memory[0], "first"),
        ]
        if servo is not None and factor > 0:
            lines += [
                Line("servo, mean period", 1e3 * servo.mean_period, "ms", 4.5, "nominal", bar=1.005),
                Line("servo, missed deadlines", servo.missed_deadlines, "", max(1, servo.tick), "ticks"),
            ]
    finally:
        rclpy.try_shutdown()
        stop_s = seconds(lambda: stop.stop(say=lambda _: None))
    return [*lines, Line("stop", stop_s, "s", bar=5.0)]


def accuracy_lines(seeds: int, port: int) -> list[Line]:
    """One command for each seed: true over expected errors, RMS over the seeds, and the mean of chi2/dof.

    Raises:
        ImError: The machine does not start, or a command fails.
    """
    path = deployments.default_path()
    ratios: dict[str, list[float]] = {"triangulation_mm": [], "reprojection_px": []}
    chi2 = []
    for seed in range(1, seeds + 1):
        if start(deployments.load(path).with_values(clock_factor=0.0, seed=seed, port=port), path, START_S) != 0:
            raise StateError(f"the machine did not start with seed {seed}")
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            bench = Bench()
            with Spinner([bench]):
                path = bench.command().folder / "report.json"
                report = add_to_report(path, get_truth(bench), load_cell())
        finally:
            rclpy.try_shutdown()
            stop.stop(say=lambda _: None)
        chi2.append(report["chi2_per_dof"])
        for name, values in ratios.items():
            values.append(report["truth_error"][name] / report["expected_error"][name])
    lines = [
        Line(f"{name}, true/expected, {seeds} seeds", math.sqrt(statistics.fmean(v * v for v in values)), "", bar=1.2)
        for name, values in ratios.items()
    ]
    return [*lines, Line(f"chi2/dof, mean of {seeds} seeds", statistics.fmean(chi2), "")]


def command_lines(number: int, factor: float, command: Command) -> list[Line]:
    """Lines of one command: its duration, its speed, and the steps that took longest."""
    timing = command.report["timing"]
    wall, simulated = timing["wall_s"], timing["simulated_s"]
    name = f"command {number} at clock factor {factor:g}"
    fast = factor == 0
    lines = [
        Line(name, wall, "s", bar=60.0 if fast else None),
        Line("  simulated time", simulated, "s", wall, "wall time", bar=5.0 if fast else None, at_least=True),
        Line("  CPU time of all processes", command.cpu_s, "s", wall, "wall time"),
    ]
    steps = sorted(timing["steps"].items(), key=lambda item: -item[1]["wall_s"])
    own = [(step, value) for step, value in steps if step.startswith("calibrate_camera.")]
    return lines + [
        Line(f"  {step.partition('.')[2]}", value["wall_s"], "s", wall, "command") for step, value in own[:5]
    ]
