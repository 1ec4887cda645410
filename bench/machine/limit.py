"""The least that the command could cost: bare physics, bare rendering and the solver, one after the other.

``python -m bench.machine.limit OBSERVATIONS.json FIGURES.json`` measures what each costs, in a process of its own: what
graphics drivers print does not mix with figures, and one that crashes takes nothing along.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.figures import Line
from bench.vss.bare import Bare
from bench.yardstick import BarePhysics, bare_physics
from im_calibration import calibrate, load_problems
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import ConfigError, ImError
from im_core.files import write_whole

#: Least share of the limit in the command.
LEAST = 0.6
CAMERA = "ceiling_left"
_TICKS, _ROUNDS, _FRAMES, _SOLUTIONS = 100, 20, 20, 3
_PATIENCE_S = 300.0


@dataclass(frozen=True)
class Cost:
    """What the bare parts cost, wall time, the least of some rounds.

    Attributes:
        tick_s: pybullet's steps of a servo tick [s].
        joints_s: The same with joint input and output [s].
        image_s: An image [s].
        solver_s: The calibration from the observations of the command [s].
        renderer: What rendered, ``egl`` or ``tiny``.
    """

    tick_s: float
    joints_s: float
    image_s: float
    solver_s: float
    renderer: str


def bare_cost(observations: Path) -> Cost:
    """Measures in a process of its own.

    Args:
        observations: Data set of a command, ``observations.json`` in its folder.

    Raises:
        ImError: It ends without figures.
    """
    with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
        file = Path(folder) / "cost.json"
        command = [sys.executable, "-m", "bench.machine.limit", str(observations), str(file)]
        try:
            ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=_PATIENCE_S)
        except subprocess.TimeoutExpired:
            raise ImError(f"the limit of the command: no figures within {_PATIENCE_S:g} s") from None
        if not file.is_file():
            said = ended.stderr.strip().rpartition("\n")[2]
            raise ImError(f"the limit of the command: no figures: {said or f'exit code {ended.returncode}'}")
        return Cost(**json.loads(file.read_text(encoding="utf-8")))


def limit_lines(report: dict[str, Any], cost: Cost) -> list[Line]:
    """The command against its limit.

    Args:
        report: Of the command; its ticks, and an image for each pose and camera, are what the limit is made of.
        cost: Of the bare parts, measured in the same run.
    """
    timing = report["timing"]
    ticks = timing["simulated_s"] / load_cell().period
    looks = timing["steps"]["calibrate_camera.find_spot"]["count"]
    images = looks * len(report["cameras"])
    physics_s, joints_s, images_s = ticks * cost.tick_s, ticks * cost.joints_s, images * cost.image_s
    limit_s = physics_s + images_s + cost.solver_s
    wall_s = timing["wall_s"]
    command = "command"
    return [
        Line("limit of the command, wall", limit_s, "s", wall_s, command, bar=LEAST, at_least=True),
        Line(f"  bare physics, {ticks:,.0f} ticks", physics_s, "s", wall_s, command),
        Line(f"  bare rendering, {images} images, {cost.renderer}", images_s, "s", wall_s, command),
        Line("  solver, the same poses", cost.solver_s, "s", wall_s, command),
        Line("limit with joint input and output", limit_s - physics_s + joints_s, "s", wall_s, command),
    ]


def _wall_of(work: Callable[[], object]) -> float:
    began = clock.monotonic()
    work()
    return clock.monotonic() - began


def _tick(bare: BarePhysics, work: Callable[[], object]) -> float:
    """Time of a tick [s], the least of some rounds in which nothing is touched."""
    times = []
    for _ in range(_ROUNDS):
        bare.lift()
        times.append(_wall_of(work) / _TICKS)
    return min(times)


def _image() -> tuple[float, str]:
    """Time of an image [s], and the renderer: the one that the cameras choose too."""
    cell, renderer = load_cell(), "egl"
    try:
        bare = Bare(cell, CAMERA, renderer)
    except ConfigError:
        renderer = "tiny"
        bare = Bare(cell, CAMERA, renderer)
    bare.take_frame()
    return min(_wall_of(bare.take_frame) for _ in range(_FRAMES)), renderer


def main() -> int:
    """Measures, and writes the figures."""
    parser = argparse.ArgumentParser(prog="python -m bench.machine.limit", description=__doc__)
    parser.add_argument("observations", type=Path)
    parser.add_argument("figures", type=Path)
    arguments = parser.parse_args()
    substeps = load_cell().substeps
    with bare_physics() as bare:
        tick_s = _tick(bare, lambda: bare.step(substeps * _TICKS))
        joints_s = _tick(bare, lambda: bare.step_with_joints(substeps * _TICKS))
    (problem, *_) = load_problems(arguments.observations)
    solver_s = min(_wall_of(lambda: calibrate(problem)) for _ in range(_SOLUTIONS))
    image_s, renderer = _image()
    cost = Cost(tick_s, joints_s, image_s, solver_s, renderer)
    write_whole(arguments.figures, json.dumps(asdict(cost)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
