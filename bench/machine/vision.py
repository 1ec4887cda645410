"""Frames and answers a second of the Vision Services System on a running machine, and where its time goes."""

import json
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray
from rclpy.signals import SignalHandlerOptions
from scipy.spatial.transform import Rotation
from std_srvs.srv import Trigger

from bench.figures import Line
from bench.machine.deadlines import GROUP, Operator, smaller
from bench.machine.truth import get_truth
from im_bringup.machine import stop
from im_bringup.machine.start import start
from im_cell.camera_model import CameraModel
from im_cell.robot.truth import CellTruth
from im_core import clock
from im_core.config import package_file
from im_core.errors import ImError, StateError
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.run import Spinner
from im_msgs.msg import Observation, Spot
from im_msgs.srv import (
    Calibrate,
    CircleFind,
    FiducialPose,
    LaserCalibrate,
    LaserPoint,
    LaserSpot3d,
    LineFind,
    LineScan,
    ReserveGroup,
    SetLight,
    Snap,
    SpotFind,
    SpotFindStereo,
)

Requests = dict[str, tuple[type, Callable[[int], Any]]]

CLIENTS = 8
PERIOD_S = 0.0045
CEILING = ["ceiling_left", "ceiling_right"]
LIGHT = "left_led"
ON_TABLE = (0.1, 1.1, 0.75)
LINES = 5

_START_S, _ANSWER_S = 90.0, 120.0
_FRAMES_S, _SERVICE_S = 4.0, 3.0
_LEAST_SHARE = 0.02
_REST = {"snap_s": "wait for the cameras", "look_s": "mirrors, spots and waits"}
"""Steps that hold those of the cameras, and what else is in them."""
_CAMERA = ("expose_s", "render_s", "warp_s", "plates_s", "lights_s", "laser_s", "noise_s", "handover_s")
_POSES = 40
_LOW, _HIGH = np.array([-0.7, -0.5, 0.6]), np.array([0.7, 0.7, 1.7])
_SPOT_SD_PX, _ARM_SD_M = 0.04, 2e-4


@dataclass
class Tally:
    """Answers of a Service: how many, the clients' time for them [s], and their time by step [s]."""

    answers: int = 0
    waited_s: float = 0.0
    steps: dict[str, float] = field(default_factory=dict)

    def add(self, seconds: float, answer: Any) -> None:
        """Count an answer.

        Raises:
            StateError: It is a refusal.
        """
        if not answer.success:
            raise StateError(f"a request of the benchmark was refused: {answer.status.message}")
        self.answers += 1
        self.waited_s += seconds
        for step, seconds in json.loads(getattr(answer, "timing_json", "") or "{}").items():
            self.steps[step] = self.steps.get(step, 0.0) + seconds


def vision_lines(part: str, renderer: str, seed: int, port: int) -> list[Line]:
    """Figures of one part, ``frames`` or ``services``.

    Args:
        part: What to measure.
        renderer: ``egl``, ``tiny`` or ``auto``.
        seed: Of the testbed.
        port: Of the display.

    Raises:
        ImError: The machine does not start, or refuses a request.
    """
    with _machine(renderer, seed, port) as operator:
        return frame_lines(operator, renderer) if part == "frames" else service_lines(operator)


def frame_lines(operator: Operator, renderer: str) -> list[Line]:
    """Frames a second of /vss/snap, one camera and all, while arms move and while they rest."""
    operator.call(ReserveGroup, "/mcs/reserve", ReserveGroup.Request(group=GROUP))
    operator.call(Trigger, "/mcs/power_on", Trigger.Request())
    operator.call(Trigger, "/mcs/enable_motion", Trigger.Request())
    everyone = _settings("auto")["cameras"]
    found = []
    for cameras, who in ((CEILING[:1], "one camera"), (everyone, f"{len(everyone)} cameras")):
        for moving in (True, False):
            with _swaying(operator) if moving else _at_rest():
                tally, wall_s = _ask(operator, Snap, "snap", _snap_of(cameras), 1, _FRAMES_S)
            state = "arms move" if moving else "nothing moves"
            name = f"{renderer}: /vss/snap, frames of {who}, {state}"
            found.append(Line(name, tally.answers * len(cameras) / wall_s, "1/s"))
            found += _where(tally)
    return found


def _snap_of(cameras: list[str]) -> Callable[[int], Snap.Request]:
    return lambda _: Snap.Request(cameras=cameras)


def service_lines(operator: Operator) -> list[Line]:
    """Answers a second of each Service, one client and several at once."""
    truth = get_truth(operator)
    operator.call(SetLight, "/testbed/set_light", SetLight.Request(name=LIGHT, on=True))
    seen = Calibrate.Request(cameras=CEILING, observations=observations(truth), apply=True)
    operator.call(Calibrate, "/vss/calibrate", seen)
    found = []
    for name, (kind, make) in requests(truth).items():
        print(f"bench: {name}", flush=True)
        one, wall_s = _ask(operator, kind, name, make, 1, _SERVICE_S)
        many, busy_s = _ask(operator, kind, name, make, CLIENTS, _SERVICE_S)
        alone = one.answers / wall_s
        found.append(Line(f"{name}: answers, one client", alone, "1/s"))
        found += _where(one)
        found.append(Line(f"{name}: answers, {CLIENTS} clients", many.answers / busy_s, "1/s", alone, "one client"))
        wait_ms = 1e3 * many.waited_s / many.answers
        found.append(Line("    until an answer", wait_ms, "ms", 1e3 * one.waited_s / one.answers, "one client"))
        found += _where(many)
    return found


def _where(tally: Tally) -> list[Line]:
    """The steps of an answer, longest first; their sum is the time until it came."""
    whole_s, answers = tally.waited_s, tally.answers
    if not tally.steps:
        return []
    steps = {step: seconds for step, seconds in tally.steps.items() if step != "total_s"}
    inner = sum(steps.get(step, 0.0) for step in _CAMERA)
    for step, rest in _REST.items():
        if inner > 0.0 and step in steps:
            steps[rest] = max(0.0, steps.pop(step) - inner)
    steps["DDS and client"] = max(0.0, whole_s - tally.steps.get("total_s", 0.0))
    whole_ms = 1e3 * whole_s / answers
    return [
        Line(f"    {step.removesuffix('_s')}", 1e3 * seconds / answers, "ms", whole_ms, "answer")
        for step, seconds in sorted(steps.items(), key=lambda item: -item[1])
        if seconds > _LEAST_SHARE * whole_s
    ]


def _ask(
    operator: Operator, kind: type, name: str, make: Callable[[int], Any], clients: int, seconds: float
) -> tuple[Tally, float]:
    """Have clients ask a Service one request after the other for a while [s]; their answers, and the wall time [s].

    Raises:
        ImError: A request is refused, or there is no answer.
    """
    tally, lock = Tally(), threading.Lock()
    failures: list[ImError] = []
    end = [0.0]

    def client_thread(rank: int) -> None:
        client, number = asking[rank], rank
        try:
            while clock.monotonic() < end[0] or number == rank:
                began = clock.monotonic()
                answer = call_blocking(client, make(number), _ANSWER_S, name)
                with lock:
                    tally.add(clock.monotonic() - began, answer)
                number += clients
        except ImError as error:
            failures.append(error)

    asking = [operator.create_client(kind, f"/vss/{name}", qos_profile=qos.SERVICES) for _ in range(clients)]
    call_blocking(asking[0], make(0), _ANSWER_S, name)
    for client in asking:
        client.wait_for_service(timeout_sec=_ANSWER_S)
    threads = [threading.Thread(target=client_thread, args=(rank,)) for rank in range(clients)]
    began = clock.monotonic()
    end[0] = began + seconds
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    wall_s = clock.monotonic() - began
    for client in asking:
        operator.destroy_client(client)
    if failures:
        raise failures[0]
    return tally, wall_s


@contextmanager
def _machine(renderer: str, seed: int, port: int) -> Iterator[Operator]:
    """Testbed, MCS and cameras, as fast as they go; stopped afterwards.

    Raises:
        StateError: It does not start.
    """
    with tempfile.TemporaryDirectory(prefix="im_bench_") as name:
        folder = Path(name)
        settings, path = folder / "vss.yaml", folder / "deployment.yaml"
        settings.write_text(yaml.safe_dump(_settings(renderer)), encoding="utf-8")
        deployment = smaller(PERIOD_S, seed, port, factor=0.0, vss={"settings": str(settings)})
        path.write_text(deployment.model_dump_json(), encoding="utf-8")  # JSON is YAML
        if start(deployment, path, _START_S) != 0:
            raise StateError(f"the machine did not start with renderer {renderer}")
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            operator = Operator()
            with Spinner([operator]):
                yield operator
        finally:
            rclpy.try_shutdown()
            stop.stop(say=lambda _: None)


def _settings(renderer: str) -> dict[str, Any]:
    """The shipped settings with another renderer."""
    text = package_file("im_vss", "config/vss.yaml").read_text(encoding="utf-8")
    settings: dict[str, Any] = yaml.safe_load(text)
    settings["frame_source"]["settings"]["renderer"] = renderer
    return settings


@contextmanager
def _swaying(operator: Operator) -> Iterator[None]:
    """The arms move to and fro until the end of a ``with`` block."""
    over = threading.Event()
    failures: list[ImError] = []

    def sway() -> None:
        try:
            while not over.is_set():
                operator.sway()
        except ImError as error:
            failures.append(error)

    thread = threading.Thread(target=sway)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    if failures:
        raise failures[0]


@contextmanager
def _at_rest() -> Iterator[None]:
    yield


def requests(truth: CellTruth) -> Requests:
    """By name of each Service its type and what makes its n-th request.

    Args:
        truth: Of the testbed, which observations for `calibrate` are drawn from.
    """
    seen = observations(truth)
    assert truth.laser is not None
    angles = truth.laser.model().angles_to(np.array(ON_TABLE))

    def at(number: int) -> list[float]:
        """Mirror angles, other than those before."""
        return [float(angle) + 0.002 * (number % 9) for angle in angles]

    span = [float(angles[0]) - 0.03, float(angles[0]) + 0.03]
    sweep = [float(angles[1]) - 0.03, float(angles[1]) + 0.03]
    return {
        "snap": (Snap, lambda _: Snap.Request(cameras=CEILING)),
        "spot_find": (SpotFind, lambda _: SpotFind.Request(cameras=CEILING)),
        "spot_find_stereo": (SpotFindStereo, lambda _: SpotFindStereo.Request(cameras=CEILING)),
        "circle_find": (CircleFind, lambda _: CircleFind.Request(camera=CEILING[0])),
        "line_find": (LineFind, lambda _: LineFind.Request(camera=CEILING[0])),
        "fiducial_pose": (FiducialPose, lambda _: FiducialPose.Request(cameras=CEILING)),
        "calibrate": (Calibrate, lambda _: Calibrate.Request(cameras=CEILING, observations=seen)),
        "laser_point": (LaserPoint, lambda n: LaserPoint.Request(angles=at(n), on=False)),
        "laser_spot_3d": (LaserSpot3d, lambda n: LaserSpot3d.Request(cameras=CEILING, angles=at(n))),
        "line_scan": (LineScan, lambda _: LineScan.Request(cameras=CEILING, span=span, sweep=sweep, lines=LINES)),
        "laser_calibrate": (LaserCalibrate, lambda _: LaserCalibrate.Request(cameras=CEILING)),
    }


def observations(truth: CellTruth) -> list[Observation]:
    """What the ceiling cameras see of the wrist light at random poses, with the noise of a good measurement."""
    rng = np.random.default_rng(truth.seed)
    cameras = {name: _model(truth, name) for name in CEILING}
    found = []
    for number in range(_POSES):
        light = rng.uniform(_LOW, _HIGH)
        rotation = Rotation.random(random_state=rng)
        wrist = light - rotation.apply(truth.leds[LIGHT].offset_m) + rng.normal(0.0, _ARM_SD_M, 3)
        seen = {name: camera.project(light) + rng.normal(0.0, _SPOT_SD_PX, 2) for name, camera in cameras.items()}
        x, y, z, w = (float(value) for value in rotation.as_quat())
        found.append(
            Observation(
                pose=f"pose_{number}",
                wrist=Pose(position=Point(**dict(zip("xyz", map(float, wrist), strict=True))),
                           orientation=Quaternion(x=x, y=y, z=z, w=w)),
                position_covariance=(_ARM_SD_M**2 * np.eye(3)).ravel(),
                spots=[_spot(name, uv) for name, uv in seen.items()],
            )
        )  # fmt: skip
    return found


def _model(truth: CellTruth, name: str) -> CameraModel:
    true = truth.cameras[name]
    return CameraModel(
        true.width, true.height, np.array(true.K), np.array(true.D), np.array(true.R_cam_base),
        np.array(true.t_cam_base_m),
    )  # fmt: skip


def _spot(camera: str, uv: NDArray[np.float64]) -> Spot:
    covariance = (_SPOT_SD_PX**2 * np.eye(2)).ravel()
    return Spot(camera=camera, found=True, u=float(uv[0]), v=float(uv[1]), covariance=covariance)
