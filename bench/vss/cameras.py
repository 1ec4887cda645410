"""``python -m bench.vss.cameras``: frames a second of the simulated cameras through one renderer, without a machine.

A process of its own: what graphics drivers print does not mix with figures, and one that crashes takes nothing along.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from bench.figures import Line, write
from bench.vss.bare import Bare
from im_cell.camera_model import nominal
from im_cell.link import Exposure, LaserBeam
from im_cell.robot import Cell, load_cell
from im_cell.robot.truth import CameraTruth, CellTruth, LaserTruth, LedTruth
from im_core import clock
from im_core.errors import ImError
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.protocol import CameraSettings
from im_sim.cameras.scene import SceneMirror
from im_vss.settings import VssSettings, load_settings

RENDERERS = ("egl", "tiny")
ONE = "ceiling_left"
BARE = "bare getCameraImage"
_DISTORTION = (-0.22, 0.04, 7e-4, -5e-4, 0.0)
LEAST_OF_BARE = 0.5
_ROUNDS = 10
_TURN_S = 0.3
_LIMIT_S = 120.0
_SWAY_RAD = 0.01
_LEAST_SHARE = 0.01


def lines(renderer: str, only_bare: bool = False) -> list[Line]:
    """Frames a second with the lights on, robot moving and at rest, next to the bare renderer; and where time goes.

    Args:
        renderer: One of :data:`RENDERERS`.
        only_bare: Measure nothing but the bare renderer.

    Raises:
        ImError: The renderer does not work.
    """
    with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
        file = Path(folder) / "lines.json"
        try:
            ended = subprocess.run(
                [sys.executable, "-m", "bench.vss.cameras", renderer, str(file), *["--bare"] * only_bare],
                check=False, capture_output=True, text=True, timeout=_LIMIT_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ImError(f"renderer {renderer}: no figures within {_LIMIT_S:g} s") from None
        if not file.is_file():
            said = ended.stderr.strip().rpartition("\n")[2]
            raise ImError(f"renderer {renderer}: no figures: {said or f'exit code {ended.returncode}'}")
        return [Line.read(entry) for entry in json.loads(file.read_text(encoding="utf-8"))]


def drawn_truth(cell: Cell) -> CellTruth:
    """A cell that is as drawn, but that its lenses distort."""
    cameras = {}
    for name, camera in cell.cameras.items():
        model = nominal(camera)
        cameras[name] = CameraTruth(
            parent=camera.parent, width=model.width, height=model.height, K=model.K.tolist(), D=_DISTORTION,
            R_cam_base=model.R_cam_base.tolist(), t_cam_base_m=model.t_cam_base.tolist(),
        )  # fmt: skip
    led = LedTruth(offset_m=cell.led.offset, axis=cell.led.axis, diameter_m=cell.led.diameter)
    rotation, position = cell.scanner.pose()
    laser = LaserTruth(
        rotation=rotation.tolist(), position_m=position.tolist(), gain=(1.0, 1.0), offset=0.0, gap_m=cell.scanner.gap
    )
    return CellTruth(seed=1, cameras=cameras, leds=dict.fromkeys(cell.light_names, led), laser=laser)


def simulated(settings: VssSettings) -> CameraSettings:
    """The simulated cameras of a configuration."""
    return CameraSettings(cameras=settings.cameras, sensor=settings.sensor, nominal_exposure=settings.exposure.nominal)


class Studio:
    """The cameras of a cell, which is moved or stands still between images."""

    def __init__(self, cell: Cell, settings: VssSettings, scene: SceneMirror) -> None:
        """Render each camera once."""
        self._cell, self._settings = cell, settings
        self.bank = CameraBank(cell, drawn_truth(cell), simulated(settings), scene, seed=1)
        list(self.bank.warm_up())
        self._frame = 0

    def take_frames(self, cameras: tuple[str, ...], moving: bool) -> None:
        """An image of each camera, after an arm has moved or not."""
        self._frame += 1
        q = self._cell.home.copy()
        if moving:
            q[4] += _SWAY_RAD * (self._frame % 5)
        beam = LaserBeam(0.05, 0.03, 0.0, self._settings.laser.spot_power)
        lit = dict.fromkeys(self._cell.light_names, 1.0)
        exposure = Exposure(self._frame * 4, self._frame * 4 + 4, stamp_ns=0, q_true=q, light_fraction=lit, laser=beam)
        for camera in cameras:
            mean = self.bank.expected(camera, exposure, self._settings.exposure.nominal, self._settings.sensor)
            out = np.zeros(mean.shape, np.uint8)
            self.bank.read_out(camera, mean, exposure.start_tick, 0, out, self._settings.sensor)


def measure(renderer: str, only_bare: bool) -> list[Line]:
    """The figures, in this process.

    Raises:
        ConfigError: The renderer does not load.
    """
    cell = load_cell()
    settings = load_settings(cell)
    size = cell.cameras[ONE].intrinsics
    bare = Turns(Bare(cell, ONE, renderer).take_frame, 1)
    name = f"{renderer}: {BARE}, {size.width}x{size.height}"
    if only_bare:
        take_turns([bare])
        return [Line(name, bare.rate, "1/s")]
    scene = SceneMirror(cell, renderer)
    studio = Studio(cell, settings, scene)
    bank = studio.bank
    found = []
    for cameras, who in (((ONE,), "one camera"), (settings.cameras, f"{len(settings.cameras)} cameras")):
        moving = Turns(partial(studio.take_frames, cameras, True), len(cameras), bank.lap)
        still = Turns(partial(studio.take_frames, cameras, False), len(cameras), bank.lap)
        take_turns([bare, moving, still])
        for turns, state, bar in ((moving, "an arm moves", LEAST_OF_BARE), (still, "nothing moves", None)):
            title = f"{renderer}: frames of {who}, {state}"
            found.append(Line(title, turns.rate, "1/s", bare.rate, "bare", bar=bar, at_least=True))
            found += step_lines(turns.steps, 1.0 / turns.rate, "frame")
    return [Line(name, bare.rate, "1/s"), *found]


class Turns:
    """Work that is done over and over, in turns with other work, so that a busy computer slows all of it down.

    Args:
        work: What is done.
        frames: Frames that it makes.
        lap: Where its time went, by step [s].
    """

    def __init__(self, work: Callable[[], None], frames: int, lap: Callable[[], dict[str, float]] = dict) -> None:
        self._work, self._frames, self._lap = work, frames, lap
        self._wall_s, self._count = 0.0, 0
        self._seconds: Counter[str] = Counter()

    def run(self, seconds: float) -> None:
        """Work for a while [s], after once for nothing."""
        self._work()
        self._lap()
        begin = clock.monotonic()
        while (wall_s := clock.monotonic() - begin) < seconds:
            self._work()
            self._count += self._frames
        self._wall_s += wall_s
        self._seconds.update(self._lap())

    @property
    def rate(self) -> float:
        """Frames a second."""
        return self._count / self._wall_s

    @property
    def steps(self) -> dict[str, float]:
        """Time of each step of a frame [s]."""
        return {step: seconds / self._count for step, seconds in self._seconds.items()}


def take_turns(works: Sequence[Turns]) -> None:
    """Have each work for a while in turn."""
    for _ in range(_ROUNDS):
        for work in works:
            work.run(_TURN_S)


def step_lines(steps: Mapping[str, float], whole_s: float, what: str) -> list[Line]:
    """Lines of the steps [s] that take more than a hundredth of a whole [s], longest first."""
    return [
        Line(f"    {step.removesuffix('_s')}", 1e3 * seconds, "ms", 1e3 * whole_s, what)
        for step, seconds in sorted(steps.items(), key=lambda item: -item[1])
        if seconds > _LEAST_SHARE * whole_s
    ]


def main() -> int:
    """Entry point; exit code 1 with one sentence if the renderer does not work."""
    parser = argparse.ArgumentParser(prog="bench.vss.cameras", description=__doc__)
    parser.add_argument("renderer", choices=RENDERERS)
    parser.add_argument("file", type=Path, help="where the figures go, as JSON")
    parser.add_argument("--bare", action="store_true", help="only the bare renderer")
    arguments = parser.parse_args()
    try:
        write(arguments.file, measure(arguments.renderer, arguments.bare))
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
