"""The camera process: waits for orders, exposes, renders, answers."""

import os
from pathlib import Path

from im_cell.link import CameraEnd
from im_cell.robot import Cell, load_cell
from im_cell.robot.truth import CellTruth, load_truth
from im_core import clock
from im_core.errors import ImError, LinkError, WaitTimeoutError
from im_core.processes.memory import give_back_zeros
from im_core.processes.startup import patience_s
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.protocol import CameraChannel, CameraReply, CameraRequest, CameraSettings, channel_name
from im_sim.cameras.scene import SceneMirror

_NICENESS = 5
_IDLE_S = 0.5
#: How long after this process the rest of the machine may still be starting, and needs the processors [s].
_OTHERS_START_S = 3.0
_POLL_S = 0.05


class CameraProcess:
    """Plays the camera hardware, one order at a time."""

    def __init__(self, instance: str, truth: Path, cell: Cell, settings: CameraSettings) -> None:
        """Attach to host and testbed and load the scene.

        Raises:
            ImError: The host or the testbed is not there, or the renderer does not load.
        """
        wait_s = patience_s()
        self._channel = CameraChannel.attach(channel_name(instance), CameraChannel.layout(cell), wait_s)
        self._instance, self._truth = instance, truth
        self._scene: SceneMirror | None = None
        self._cell, self._settings = cell, settings
        self._link = CameraEnd.attach(instance, wait_s)
        self._bank = self._new_bank()
        self._rested = False
        self._cold = self._bank.warm_up()
        next(self._cold, None)  # a graphics driver that crashes does so now, before anybody counts on it

    def run(self) -> None:
        """Serve until the host is gone; the cameras take the first images a while later, but before an order.

        A scene that was rendered is used again where nothing moved: what was rendered first must not hang on who asks.
        """
        self._send(CameraReply(0))
        begin = clock.monotonic() + _OTHERS_START_S
        while self._channel.owner_alive():
            message = self._channel.requests.receive()
            if message is None:
                if clock.monotonic() < begin:
                    self._channel.requested.wait(_IDLE_S)
                elif next(self._cold, None) is None:
                    self._rest()
                    self._channel.requested.wait(_IDLE_S)
                continue
            for _ in self._cold:
                pass
            request = CameraRequest.from_json(message)
            try:
                reply = self._serve(request)
            except ImError as error:
                reply = CameraReply.failed(request.number, error)
            self._send(reply)

    def _rest(self) -> None:
        """Give back the 128 MiB reserved by the renderer, once, after all cameras are warm."""
        if not self._rested:
            self._rested = True
            give_back_zeros()

    def _serve(self, request: CameraRequest) -> CameraReply:
        """Carry out an order, in whole ticks; tell when all is exposed, for then the arms may go on.

        Raises:
            ImError: The testbed does not expose.
        """
        if not self._link.physics_alive():
            self._reattach()
        ticks = max(1, round(request.exposure_s / self._link.period_s))
        exposure_s = ticks * self._link.period_s
        begin = clock.monotonic()
        exposures = [self._link.expose(ticks, light, request.timeout_s, laser) for light, laser in request.strobes]
        exposed = clock.monotonic()
        stamps_ns = tuple(exposure.stamp_ns for exposure in exposures)
        self._send(CameraReply(request.number, stamps_ns, exposed=True))
        self._bank.lap()
        for frame, exposure in enumerate(exposures):
            for camera in request.cameras:
                sensor = request.controls[camera].of(self._settings.sensor)
                mean = self._bank.expected(camera, exposure, exposure_s, sensor)
                out = self._channel.image(camera, frame)
                self._bank.read_out(camera, mean, exposure.start_tick, frame, out, sensor)
        return CameraReply(
            request.number,
            stamps_ns,
            timing={"expose_s": exposed - begin, **self._bank.lap()},
            exposure_s=exposure_s,
        )

    def _reattach(self) -> None:
        """Follow the testbed to the next incarnation."""
        try:
            link = CameraEnd.attach(self._instance, _POLL_S)
        except LinkError:
            raise LinkError("the testbed is missing: no exposure without its physics process") from None
        self._link.close()
        self._link = link
        self._bank = self._new_bank()

    def _new_bank(self) -> CameraBank:
        """Create scene and cameras of the present testbed: the truth, and the period, possibly not the cell's own."""
        truth = _await_truth(self._truth, self._link.seed)
        cell = self._cell.at_period(round(self._link.period_s, 9))  # whole nanoseconds in the link
        if self._scene is not None:
            self._scene.close()
        self._scene = SceneMirror(truth.built(cell), self._settings.renderer)
        return CameraBank(cell, truth, self._settings, self._scene, self._link.seed)

    def _send(self, reply: CameraReply) -> None:
        self._channel.replies.send(reply.to_json())
        self._channel.replied.post()


def run(instance: str, truth: Path, settings: CameraSettings) -> None:
    """Run the camera process until the host is gone.

    Raises:
        ImError: It cannot start.
    """
    os.nice(_NICENESS)
    CameraProcess(instance, truth, load_cell(), settings).run()


def _await_truth(path: Path, seed: int) -> CellTruth:
    """Return the truth file of the testbed with a seed once present; a file of an earlier machine is ignored.

    Raises:
        WaitTimeoutError: It did not appear.
        DataError: It is malformed.
    """
    wait_s = patience_s()
    deadline = clock.monotonic() + wait_s
    while clock.monotonic() < deadline:
        if path.is_file() and (truth := load_truth(path)).seed == seed:
            return truth
        clock.sleep(_POLL_S)
    raise WaitTimeoutError(what=f"the testbed to write {path.name} for seed {seed}", seconds=wait_s)
