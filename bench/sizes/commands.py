"""The whole command with few and with many poses, and beside a recorder of all topics."""

from collections.abc import Sequence
from pathlib import Path

import rclpy
import yaml
from rclpy.signals import SignalHandlerOptions

from bench.bag.recorder import recorder
from bench.figures import Line
from bench.machine.command import START_S, Bench, Command
from bench.sizes.growth import growth
from im_bringup.machine import stop
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_core.config import package_file
from im_core.errors import StateError
from im_core.ros.run import Spinner


def lines(sizes: Sequence[int], port: int, folder: Path) -> list[Line]:
    """The command at clock factor 0: CPU time of the whole machine, and wall time.

    Raises:
        ImError: The machine does not start, or a command fails.
    """
    path = deployments.default_path()
    if start(deployments.load(path).with_values(clock_factor=0.0, seed=1, port=port), path, START_S) != 0:
        raise StateError("the machine did not start")
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        bench = Bench()
        with Spinner([bench]):
            files = {count: poses_file(count, folder) for count in sizes}
            done = {count: _told(bench, count, file) for count, file in files.items()}
            smallest = min(sizes)
            with recorder(folder / "bag"):
                recorded = _told(bench, smallest, files[smallest])
    finally:
        rclpy.try_shutdown()
        stop.stop(say=lambda _: None)
    plain = done[smallest]
    return [
        *growth("command, CPU", {count: command.cpu_s for count, command in done.items()}, "s", "poses"),
        *growth("command, wall", {count: _wall_s(command) for count, command in done.items()}, "s", "poses"),
        Line(f"command, {smallest} poses, with a bag, CPU", recorded.cpu_s, "s", plain.cpu_s, "without a bag"),
        Line("  wall", _wall_s(recorded), "s", _wall_s(plain), "without a bag"),
    ]


def poses_file(count: int, folder: Path) -> Path:
    """A file of so many poses: the cell's own, from the first on, as often as it takes."""
    content = yaml.safe_load(package_file("im_cell", "cells/puma_pair/ceiling_40.yaml").read_text(encoding="utf-8"))
    own = content["poses"]
    content["poses"] = [{**own[number % len(own)], "name": f"n{number}"} for number in range(count)]
    path = folder / f"poses_{count}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def _told(bench: Bench, count: int, poses: Path) -> Command:
    print(f"bench: command of {count} poses", flush=True)
    return bench.command(poses)


def _wall_s(command: Command) -> float:
    return float(command.report["timing"]["wall_s"])
