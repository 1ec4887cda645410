"""Frames and answers a second of the Vision Services System on a running machine, and where its time goes."""

import json
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from im_bringup import stop
from im_bringup.ros.deadlines import GROUP, Operator, smaller
from im_bringup.ros.truth_error import get_truth
from im_bringup.ros.vision_requests import CEILING, LIGHT, observations, requests
from im_bringup.start import start
from im_core import clock
from im_core.config import package_file
from im_core.errors import ImError, StateError
from im_core.figures import Line
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.run import Spinner
from im_msgs.srv import Calibrate, ReserveGroup, SetLight, Snap

CLIENTS = 8
PERIOD_S = 0.0045
_START_S, _ANSWER_S = 90.0, 120.0
_FRAMES_S, _SERVICE_S = 4.0, 3.0
_LEAST_SHARE = 0.02
_REST = {"snap_s": "wait for the cameras", "look_s": "mirrors, spots and waits"}
"""Steps that hold those of the cameras, and what else is in them."""
_CAMERA = ("expose_s", "render_s", "warp_s", "plates_s", "lights_s", "laser_s", "noise_s", "handover_s")


@dataclass
class Tally:
    """Answers of a Service: how many, the clients' time for them [s], and their time by step [s]."""

    answers: int = 0
    waited_s: float = 0.0
    steps: Counter[str] = field(default_factory=Counter)

    def add(self, seconds: float, answer: Any) -> None:
        """Count an answer.

        Raises:
            StateError: It is a refusal.
        """
        if not answer.success:
            raise StateError(f"a request of the benchmark was refused: {answer.status.message}")
        self.answers += 1
        self.waited_s += seconds
        self.steps.update(json.loads(getattr(answer, "timing_json", "") or "{}"))


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
                asked = Snap.Request(cameras=cameras)
                tally, wall_s = _ask(operator, Snap, "snap", lambda _, asked=asked: asked, 1, _FRAMES_S)
            state = "arms move" if moving else "nothing moves"
            name = f"{renderer}: /vss/snap, frames of {who}, {state}"
            found.append(Line(name, tally.answers * len(cameras) / wall_s, "1/s"))
            found += _where(tally)
    return found


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
    steps = Counter({step: seconds for step, seconds in tally.steps.items() if step != "total_s"})
    inner = sum(steps[step] for step in _CAMERA)
    for step, rest in _REST.items():
        if inner > 0.0 and step in steps:
            steps[rest] = max(0.0, steps.pop(step) - inner)
    steps["DDS and client"] = max(0.0, whole_s - tally.steps["total_s"])
    whole_ms = 1e3 * whole_s / answers
    return [
        Line(f"    {step.removesuffix('_s')}", 1e3 * seconds / answers, "ms", whole_ms, "answer")
        for step, seconds in steps.most_common()
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
    return {**yaml.safe_load(text), "renderer": renderer}


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
