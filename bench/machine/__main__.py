"""``bench``: how fast the machine is, as ratios to baselines of the same run."""

import argparse
import json
import math
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions

from bench.figures import Line, report, write
from bench.machine.deadlines import deadline_lines
from bench.machine.pairs import pair_lines
from bench.machine.vision import vision_lines
from bench.usage import memory_mib
from im_bringup.calibration.truth import truth_error
from im_bringup.machine import leftovers, stop
from im_bringup.machine.interrupts import interrupt_once
from im_bringup.machine.start import start
from im_bringup.ros.calibrate_camera import CalibrateCameraClient
from im_bringup.ros.truth_error import get_truth
from im_bringup.tasks import deployment as deployments
from im_core import clock
from im_core.errors import ImError, StateError
from im_core.ros import qos
from im_core.ros.run import Spinner
from im_msgs.msg import McsState

START_S = 120.0
NODE = "import rclpy; from rclpy.node import Node; rclpy.init(); Node('bare')"


class Bench(CalibrateCameraClient):
    """Commands the machine and listens to the servo."""

    def __init__(self) -> None:
        super().__init__(progress=None)
        self.servo: McsState | None = None
        self.create_subscription(McsState, "/mcs/state", self._keep, qos.LATCHED)

    def _keep(self, message: McsState) -> None:
        self.servo = message

    def command(self) -> dict[str, Any]:
        """Calibrate the ceiling cameras and return the report.

        Raises:
            StateError: The command failed.
        """
        answer = self.calibrate([], "")
        if not answer.success:
            raise StateError(f"calibrate_camera failed: {answer.message}")
        report: dict[str, Any] = json.loads(answer.report.json)
        return report


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
    deployment = deployments.load(path).with_values(factor, seed, port)
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
                timing = bench.command()["timing"]
                memory.append(memory_mib(process.pid for process in leftovers.processes()))
                lines += command_lines(number + 1, factor, timing)
            servo = bench.servo
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
        if start(deployments.load(path).with_values(0.0, seed, port), path, START_S) != 0:
            raise StateError(f"the machine did not start with seed {seed}")
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            bench = Bench()
            with Spinner([bench]):
                report = bench.command()
                error = truth_error(report, get_truth(bench))
        finally:
            rclpy.try_shutdown()
            stop.stop(say=lambda _: None)
        chi2.append(report["chi2_per_dof"])
        for name, values in ratios.items():
            values.append(error[name] / report["expected_error"][name])
    lines = [
        Line(f"{name}, true/expected, {seeds} seeds", math.sqrt(statistics.fmean(v * v for v in values)), "", bar=1.2)
        for name, values in ratios.items()
    ]
    return [*lines, Line(f"chi2/dof, mean of {seeds} seeds", statistics.fmean(chi2), "")]


def command_lines(number: int, factor: float, timing: dict[str, Any]) -> list[Line]:
    """Lines of one command: its duration, its speed, and the steps that took longest."""
    wall, simulated = timing["wall_s"], timing["simulated_s"]
    name = f"command {number} at clock factor {factor:g}"
    fast = factor == 0
    lines = [
        Line(name, wall, "s", bar=60.0 if fast else None),
        Line("  simulated time", simulated, "s", wall, "wall time", bar=5.0 if fast else None, at_least=True),
    ]
    steps = sorted(timing["steps"].items(), key=lambda item: -item[1]["wall_s"])
    own = [(step, value) for step, value in steps if step.startswith("calibrate_camera.")]
    return lines + [
        Line(f"  {step.partition('.')[2]}", value["wall_s"], "s", wall, "command") for step, value in own[:5]
    ]


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="bench", description="Measure the machine against baselines of the same run.")
    parser.add_argument("--runs", type=int, default=2, help="commands at clock factor 0 (default: %(default)d)")
    parser.add_argument(
        "--real-time",
        action="store_true",
        help="also one command in real time, for the servo; with --pairs: in real time",
    )
    parser.add_argument("--seeds", type=int, default=0, help="instead: the accuracy over this many seeds")
    parser.add_argument("--deadlines", action="store_true", help="instead: missed deadlines of the servo in real time")
    parser.add_argument("--pairs", type=int, default=0, metavar="N", help="instead: N times two moves at once")
    parser.add_argument("--vision", choices=("frames", "services"), help="instead: speed of the vision services")
    parser.add_argument(
        "--renderer", choices=("auto", "egl", "tiny"), default="auto", help="of the cameras, with --vision"
    )
    parser.add_argument("--lines", type=Path, metavar="FILE", help="write the figures here only, as JSON")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--port", type=int, default=8080)
    arguments = parser.parse_args()
    if arguments.runs < 1 or min(arguments.seeds, arguments.pairs) < 0:
        least = f"--runs {arguments.runs} must be at least 1, --seeds {arguments.seeds} and --pairs {arguments.pairs}"
        parser.error(f"{least} at least 0")
    interrupt_once()
    try:
        if arguments.deadlines:
            lines = deadline_lines(arguments.seed, arguments.port)
        elif arguments.pairs:
            lines = pair_lines(arguments.pairs, 1.0 if arguments.real_time else 0.0, arguments.port)
        elif arguments.vision:
            lines = vision_lines(arguments.vision, arguments.renderer, arguments.seed, arguments.port)
        elif arguments.seeds:
            lines = accuracy_lines(arguments.seeds, arguments.port)
        else:
            lines = machine_lines(0.0, arguments.seed, arguments.port, arguments.runs)
        if arguments.real_time and not arguments.pairs:
            lines += machine_lines(1.0, arguments.seed, arguments.port, 1)
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return 130
    except ImError as error:
        print(f"bench: {error.message}", file=sys.stderr)
        return 1
    if arguments.lines is not None:
        write(arguments.lines, lines)
        return 0
    return 0 if report("bench", lines) else 1


if __name__ == "__main__":
    sys.exit(main())
