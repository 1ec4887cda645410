"""Host of the camera process: starts the process, orders images, starts the process again after the death."""

import threading
from contextlib import ExitStack, closing, suppress

from pydantic import ValidationError

from im_cell.frames import Exposed, Frame, FrameSet, FrameSource, FrameSourceSetup, SnapOrder, nobody
from im_cell.link import RateEnd
from im_cell.robot.truth import FILE_NAME
from im_cell.sensor import SensorControls
from im_core import clock, names
from im_core.config import faults
from im_core.errors import ConfigError, ImError, LinkError, WaitTimeoutError
from im_core.processes.process import ChildProcess, prepare
from im_sim.cameras.protocol import CameraChannel, CameraReply, CameraRequest, CameraSettings, channel_name

_CAMERAS = "im_sim.cameras"
_SLICE_S = 0.1
_RENDER_BUDGET_S = 5.0


class CameraHost(FrameSource):
    """Owns the camera process; one order at a time.

    Args:
        setup: Cameras; the source's own settings are ``renderer``: ``auto``, ``egl`` or ``tiny``. ``auto`` turns into
            ``tiny`` when the process crashed, or hung, before it was ready.

    Raises:
        ConfigError: The settings are wrong.
    """

    @classmethod
    def prepare(cls) -> None:
        """Have the camera process loaded."""
        prepare(_CAMERAS)

    def __init__(self, setup: FrameSourceSetup) -> None:
        known = {"cameras": setup.cameras, "sensor": setup.sensor, "nominal_exposure": setup.nominal_exposure_s}
        try:
            self._settings = CameraSettings.model_validate({**setup.settings, **known})
        except ValidationError as error:
            first = faults(error, CameraSettings)[0]
            raise ConfigError(f"frame_source.settings.{first.field}: {first.sentence}", field=first.field) from error
        self._start_timeout_s = setup.start_timeout_s
        self._layout = CameraChannel.layout(setup.cell)
        self._lock = threading.Lock()
        self._shared = ExitStack()  # what is closed with the process
        self._child: ChildProcess | None = None
        self._rates: RateEnd | None = None
        self._ready = False
        self._number = 0

    def start(self) -> None:
        """Create the shared memory and start the process; :meth:`wait_ready` waits for the process.

        Raises:
            LinkError: Another machine of the same instance runs on this host.
        """
        with self._lock:
            self._start()

    def wait_ready(self) -> None:
        """Wait until the cameras can be used.

        Raises:
            LinkError: The process ended.
            WaitTimeoutError: It is not ready in time; it is ended.
        """
        with self._lock:
            self._await_ready()

    def revive(self) -> str:
        """Start a dead process again; return the cause, empty if the process lives or is busy with an order."""
        if not self._lock.acquire(blocking=False):
            return ""
        try:
            if self._child is None or self._child.poll() is None:
                return ""
            obituary = self._obituary()
            self._restart()
            return obituary
        finally:
            self._lock.release()

    def take_frames(self, order: SnapOrder, exposed: Exposed = nobody) -> FrameSet:
        """Expose and read out.

        Raises:
            LinkError: The camera process died.
            WaitTimeoutError: It did not answer; it is ended, and started again.
            ImError: As reported by the camera process.
        """
        with self._lock:
            if self._child is None:
                raise LinkError("the camera process is not started")
            if self._child.poll() is not None:
                self._restart()
            begin = clock.monotonic()
            self._await_ready()
            self._number += 1
            controls = {camera: order.controls.get(camera, SensorControls()) for camera in order.cameras}
            request = CameraRequest(
                self._number, order.cameras, order.strobes, order.exposure_s, order.timeout_s, controls
            )
            self._channel.requests.send(request.to_json())
            self._channel.requested.post()
            timeout_s = len(order.blank_light) * order.timeout_s + _RENDER_BUDGET_S
            reply = self._answer(self._number, timeout_s, exposed)
            if reply.error is not None:
                raise ImError.restored(reply.error["code"], reply.error["message"], reply.error["facts"])
            frames = {
                camera: tuple(
                    Frame(camera, self._channel.image(camera, index).copy(), stamp, blank, controls[camera])
                    for index, (stamp, blank) in enumerate(zip(reply.stamps_ns, order.blank_light, strict=True))
                )
                for camera in order.cameras
            }
            timing = dict(reply.timing or {})
            timing["handover_s"] = max(0.0, clock.monotonic() - begin - sum(timing.values()))
            return FrameSet(frames, timing, reply.exposure_s)

    def await_image(self, due_ns: int | None) -> None:
        """Hold the time of the testbed, if there is one, for an image at clock factor 0."""
        if self._rates is not None and not self._rates.physics_alive():
            self._leave_testbed()
        if self._rates is None and due_ns is not None:
            with suppress(LinkError):
                self._rates = RateEnd.attach(names.instance(), 0.0)
        if self._rates is not None:
            self._rates.await_image(due_ns)

    def close(self) -> None:
        """End the process and remove the shared memory; no image is awaited any more."""
        self.await_image(None)
        self._leave_testbed()
        with self._lock:
            if self._child is None:
                return
            self._child.stop()
            self._child = None
            self._shared.close()

    def _leave_testbed(self) -> None:
        if self._rates is not None:
            self._rates.close()
            self._rates = None

    def _start(self) -> None:
        run_dir = names.run_dir()
        arguments = ["--instance", names.instance(), "--truth", str(run_dir / FILE_NAME)]
        arguments += ["--settings", self._settings.model_dump_json()]
        with ExitStack() as shared:
            channel = CameraChannel.create(channel_name(names.instance()), self._layout)
            self._channel = shared.enter_context(closing(channel))
            self._ready = False
            self._child = ChildProcess.of_module(_CAMERAS, arguments, log=run_dir / "camera.log")
            self._shared = shared.pop_all()

    def _restart(self) -> None:
        code = self._child.poll() if self._child is not None else None
        if not self._ready and self._settings.renderer == "auto" and code is not None and code < 0:
            # a graphics driver that crashes or hangs does so at the start
            self._settings = self._settings.model_copy(update={"renderer": "tiny"})
        self._shared.close()
        self._start()

    def _await_ready(self) -> None:
        if not self._ready:
            reply = self._answer(0, self._start_timeout_s)
            if reply.error is not None:
                raise ImError.restored(reply.error["code"], reply.error["message"], reply.error["facts"])
            self._ready = True

    def _answer(self, number: int, timeout_s: float, exposed: Exposed = nobody) -> CameraReply:
        """Return the last reply to a request; end a process without a reply in time."""
        try:
            return self._receive(number, timeout_s, exposed)
        except WaitTimeoutError:
            if self._child is not None:
                self._child.stop()
            raise

    def _receive(self, number: int, timeout_s: float, exposed: Exposed = nobody) -> CameraReply:
        """The last reply to a request; older ones are dropped."""
        deadline = clock.monotonic() + timeout_s
        while clock.monotonic() < deadline:
            message = self._channel.replies.receive()
            if message is None:
                if self._child is not None and self._child.poll() is not None and self._channel.replies.empty():
                    raise LinkError(self._obituary(), process=_CAMERAS)
                self._channel.replied.wait(_SLICE_S)
                continue
            reply = CameraReply.from_json(message)
            if reply.number != number:
                continue
            if not reply.exposed:
                return reply
            exposed(reply.stamps_ns)
        what = "the camera process to answer" if number else "the camera process to be ready"
        raise WaitTimeoutError(what=what, seconds=timeout_s)

    def _obituary(self) -> str:
        return "the camera process is missing" + (f": {self._child.obituary()}" if self._child is not None else "")
