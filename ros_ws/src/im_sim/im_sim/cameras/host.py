"""The node's end of the camera process: starts it, orders images, starts it again when it dies."""

import threading
from collections.abc import Callable
from typing import Protocol

from im_core import clock
from im_core.errors import ImError, LinkError, WaitTimeoutError
from im_core.robot import Cell
from im_core.shm import MessageRing, Semaphore, SharedBlock
from im_vss.camera.protocol import ChannelNames, ImageStore, Reply, Request
from im_vss.frames import Frame, FrameSet, SensorControls, SnapOrder

_SLICE_S = 0.1
_RENDER_BUDGET_S = 5.0


class Child(Protocol):
    """A child process, such as :class:`im_core.ros.subprocess.ChildProcess`."""

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""

    def last_words(self) -> str:
        """The last line it wrote."""

    def terminate(self) -> None:
        """End it."""


class CameraHost:
    """Owns the camera process; one order at a time.

    Args:
        instance: Name of the machine's instance.
        cell: Cameras and their image sizes.
        spawn: Starts the camera process with the given renderer (``auto``, ``egl`` or ``tiny``).
        renderer: Renderer to start with; ``auto`` turns into ``tiny`` when the process crashed before it was ready.
        start_timeout_s: How long it may take until ready [s].
    """

    def __init__(
        self, instance: str, cell: Cell, spawn: Callable[[str], Child], renderer: str, start_timeout_s: float
    ) -> None:
        self._names = ChannelNames(instance)
        self._store = ImageStore(cell)
        self._spawn = spawn
        self._renderer = renderer
        self._start_timeout_s = start_timeout_s
        self._lock = threading.Lock()
        self._child: Child | None = None
        self._ready = False
        self._number = 0

    def start(self) -> None:
        """Create the shared memory and start the process; :meth:`wait_ready` waits for it.

        Raises:
            LinkError: Another machine of the same instance runs on this host.
        """
        with self._lock:
            self._start()

    def wait_ready(self) -> None:
        """Wait until the cameras can be used.

        Raises:
            LinkError: The process ended.
            WaitTimeoutError: It is not ready in time.
        """
        with self._lock:
            self._await_ready()

    def revive(self) -> str:
        """Start the process again if it died; what it died of, empty if it lives or is busy with an order."""
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

    def take(self, order: SnapOrder) -> FrameSet:
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
            request = Request(self._number, order.cameras, order.strobes, order.exposure_s, order.timeout_s, controls)
            self._requests.send(request.to_json())
            self._requested.post()
            timeout_s = len(order.blank_light) * order.timeout_s + _RENDER_BUDGET_S
            try:
                reply = self._receive(self._number, timeout_s)
            except WaitTimeoutError:
                self._child.terminate()
                raise
            if reply.error is not None:
                raise ImError.restored(reply.error["code"], reply.error["message"], reply.error["facts"])
            frames = {
                camera: tuple(
                    Frame(camera, self._store.image(self._images, camera, index).copy(), stamp, blank, controls[camera])
                    for index, (stamp, blank) in enumerate(zip(reply.stamps_ns, order.blank_light, strict=True))
                )
                for camera in order.cameras
            }
            timing = dict(reply.timing or {})
            timing["handover_s"] = max(0.0, clock.monotonic() - begin - sum(timing.values()))
            return FrameSet(frames, timing)

    def close(self) -> None:
        """End the process and remove the shared memory."""
        with self._lock:
            if self._child is None:
                return
            self._child.terminate()
            self._child = None
            self._release()

    def _start(self) -> None:
        names = self._names
        self._images = SharedBlock.create(names.images, self._store.size)
        self._images.publish()
        self._replies = MessageRing.create(names.replies)
        self._requested = Semaphore.create(names.requested)
        self._replied = Semaphore.create(names.replied)
        self._requests = MessageRing.create(names.requests)
        self._ready = False
        self._child = self._spawn(self._renderer)

    def _restart(self) -> None:
        code = self._child.poll() if self._child is not None else None
        if not self._ready and self._renderer == "auto" and code is not None and code < 0:
            self._renderer = "tiny"  # a graphics driver that crashes does so at the start
        self._release()
        self._start()

    def _release(self) -> None:
        for part in (self._requests, self._replies, self._requested, self._replied, self._images):
            part.close()

    def _await_ready(self) -> None:
        if not self._ready:
            reply = self._receive(0, self._start_timeout_s)
            if reply.error is not None:
                raise ImError.restored(reply.error["code"], reply.error["message"], reply.error["facts"])
            self._ready = True

    def _receive(self, number: int, timeout_s: float) -> Reply:
        """The reply to a request; older ones are dropped."""
        deadline = clock.monotonic() + timeout_s
        while clock.monotonic() < deadline:
            message = self._replies.receive()
            if message is None:
                if self._child is not None and self._child.poll() is not None and self._replies.empty():
                    raise LinkError(self._obituary(), process="im_vss.camera")
                self._replied.wait(_SLICE_S)
                continue
            reply = Reply.from_json(message)
            if reply.number == number:
                return reply
        what = "the camera process to answer" if number else "the camera process to be ready"
        raise WaitTimeoutError(what=what, seconds=timeout_s)

    def _obituary(self) -> str:
        child = self._child
        if child is None:
            return "the camera process is missing"
        return f"the camera process is missing: it ended with code {child.poll()}: {child.last_words()}"
