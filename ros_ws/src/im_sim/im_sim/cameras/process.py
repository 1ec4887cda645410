"""The camera process: waits for orders, exposes, renders, answers."""

import os
from dataclasses import dataclass
from pathlib import Path

from im_core import clock
from im_core.errors import ImError, LinkError, WaitTimeoutError
from im_core.robot import Cell, load_cell
from im_core.robot.truth import CellTruth, load_truth
from im_core.shm import MessageRing, Semaphore, SharedBlock
from im_core.testbed_link import TestbedLink
from im_vss.camera.bank import CameraBank
from im_vss.camera.protocol import ChannelNames, ImageStore, Reply, Request
from im_vss.camera.scene import SceneMirror
from im_vss.settings import VssSettings, load_settings

_NICENESS = 5
_ATTACH_TIMEOUT_S = 25.0
_IDLE_S = 0.5
_POLL_S = 0.05


@dataclass(frozen=True)
class Options:
    """How the process was started: instance of the machine, file of the testbed's truth, renderer."""

    instance: str
    truth: Path
    renderer: str


class CameraProcess:
    """Plays the camera hardware, one order at a time."""

    def __init__(self, options: Options, cell: Cell, settings: VssSettings) -> None:
        """Attach to host and testbed and load the scene.

        Raises:
            ImError: The host or the testbed is not there, or the renderer does not load.
        """
        names = ChannelNames(options.instance)
        self._images = SharedBlock.attach(names.images, _ATTACH_TIMEOUT_S)
        self._requests = MessageRing.attach(names.requests, _ATTACH_TIMEOUT_S)
        self._replies = MessageRing.attach(names.replies, _ATTACH_TIMEOUT_S)
        self._requested = Semaphore.attach(names.requested, _ATTACH_TIMEOUT_S)
        self._replied = Semaphore.attach(names.replied, _ATTACH_TIMEOUT_S)
        self._store = ImageStore(cell)
        self._options = options
        self._scene = SceneMirror(cell, options.renderer)
        self._cell, self._settings = cell, settings
        self._link = TestbedLink.attach(options.instance, _ATTACH_TIMEOUT_S)
        self._bank = self._new_bank()
        self._bank.warm_up()

    def run(self) -> None:
        """Serve until the host is gone."""
        self._send(Reply(0))
        while self._requests.owner_alive():
            message = self._requests.receive()
            if message is None:
                self._requested.wait(_IDLE_S)
                continue
            request = Request.from_json(message)
            try:
                reply = self._serve(request)
            except ImError as error:
                reply = Reply.failed(request.number, error)
            self._send(reply)

    def _serve(self, request: Request) -> Reply:
        """Carry out an order.

        Raises:
            ImError: The testbed does not expose.
        """
        if not self._link.physics_alive():
            self._reattach()
        ticks = max(1, round(request.exposure_s / self._link.period_s))
        begin = clock.monotonic()
        exposures = [self._link.expose(ticks, light, request.timeout_s, laser) for light, laser in request.strobes]
        exposed = clock.monotonic()
        self._bank.lap()
        for frame, exposure in enumerate(exposures):
            for camera in request.cameras:
                sensor = request.controls[camera].of(self._settings.sensor)
                mean = self._bank.expected(camera, exposure, ticks * self._link.period_s, sensor)
                out = self._store.image(self._images, camera, frame)
                self._bank.read_out(camera, mean, exposure.start_tick, frame, out, sensor)
        return Reply(
            request.number,
            stamps_ns=tuple(exposure.stamp_ns for exposure in exposures),
            timing={"expose_s": exposed - begin, **self._bank.lap()},
        )

    def _reattach(self) -> None:
        """Follow the testbed to its next incarnation."""
        try:
            link = TestbedLink.attach(self._options.instance, _POLL_S)
        except LinkError:
            raise LinkError("the testbed is missing: no exposure without its physics process") from None
        self._link.close()
        self._link = link
        self._bank = self._new_bank()

    def _new_bank(self) -> CameraBank:
        truth = _await_truth(self._options.truth, self._link.seed)
        return CameraBank(self._cell, truth, self._settings, self._scene, self._link.seed)

    def _send(self, reply: Reply) -> None:
        self._replies.send(reply.to_json())
        self._replied.post()


def run(options: Options, cell_file: Path | None, settings_file: Path | None) -> None:
    """Run the camera process until its host is gone; the shipped files by default.

    Raises:
        ImError: It cannot start.
    """
    os.nice(_NICENESS)
    cell = load_cell(cell_file)
    CameraProcess(options, cell, load_settings(cell, settings_file)).run()


def _await_truth(path: Path, seed: int) -> CellTruth:
    """The truth file of the testbed with a seed, as soon as it is there; one of an earlier machine is passed over.

    Raises:
        WaitTimeoutError: It did not appear.
        DataError: It is malformed.
    """
    deadline = clock.monotonic() + _ATTACH_TIMEOUT_S
    while clock.monotonic() < deadline:
        if path.is_file() and (truth := load_truth(path)).seed == seed:
            return truth
        clock.sleep(_POLL_S)
    raise WaitTimeoutError(what=f"the testbed to write {path.name} for seed {seed}", seconds=_ATTACH_TIMEOUT_S)
