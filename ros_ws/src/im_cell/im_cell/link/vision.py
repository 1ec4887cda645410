"""Ends of the testbed link for vision: the cameras and the laser scanner."""

from typing import ClassVar

from im_cell.link.end import ClockEnd, LinkEnd, TimeSlot
from im_cell.link.values import Exposure, LaserBeam
from im_core import clock
from im_core.errors import DataError, LinkError, WaitTimeoutError

_SLICE_S = 0.1
MAX_EXPOSURE_TICKS = 10_000


class CameraEnd(LinkEnd):
    """Asks for exposures."""

    def expose(self, ticks: int, blank_light: bool, timeout_s: float, blank_laser: bool = False) -> Exposure:
        """Open the shutter at the next tick boundary for ``ticks`` ticks, and wait until the shutter has closed.

        One client at a time: a request replaces one that is still pending.

        Args:
            ticks: Length of the exposure, 1 to 10,000 [ticks].
            blank_light: Whether the wrist lights are strobed off during the exposure.
            timeout_s: How long to wait, wall time [s].
            blank_laser: Whether the laser is strobed off during the exposure.

        Raises:
            DataError: ``ticks`` is out of range.
            LinkError: Physics is gone.
            WaitTimeoutError: The exposure did not end in time.
        """
        if not 1 <= ticks <= MAX_EXPOSURE_TICKS:
            raise DataError(f"an exposure of {ticks} ticks is not between 1 and {MAX_EXPOSURE_TICKS}", ticks=ticks)
        shared, view = self._shared, self._shared.view
        shared.exposed.drain()
        request = int(view["exposure_request"]) + 1
        view["exposure_ticks"][()] = ticks
        view["exposure_blank"][()] = blank_light
        view["exposure_blank_laser"][()] = blank_laser
        view["exposure_request"][()] = request
        shared.wake.post()
        deadline = clock.monotonic() + timeout_s
        while int(view["exposure_done"]) != request:
            left = deadline - clock.monotonic()
            if left <= 0.0:
                what = f"an exposure of {ticks} ticks by the testbed's physics (process {self.physics_pid})"
                raise WaitTimeoutError(what=what, seconds=timeout_s)
            if not shared.exposed.wait(min(left, _SLICE_S)) and not shared.block.owner_alive():
                raise LinkError("the testbed's physics process is gone")
        start, end = int(view["exposure_start"]), int(view["exposure_end"])
        fractions = view["exposure_light"].tolist()
        return Exposure(
            start_tick=start,
            end_tick=end,
            stamp_ns=(start + end) * shared.period_ns // 2,
            q_true=view["exposure_q"].copy(),
            light_fraction=dict(zip(shared.light_names, fractions, strict=False)),
            laser=LaserBeam(*view["exposure_laser"].tolist()),
            bodies=view["exposure_bodies"].copy(),
            jaws=view["exposure_jaws"].copy(),
        )


class RateEnd(LinkEnd):
    """End of the link to announce due images taken at a rate; one client at a time."""

    def await_image(self, due_ns: int | None) -> None:
        """Let simulated time wait, at clock factor 0, for a due image, until the next call.

        What others want of time waits, for a second at most (:data:`im_cell.link.host.IMAGE_PATIENCE_S`).

        Args:
            due_ns: When the next image is due, testbed time [ns]; None: none is.
        """
        tick = 0 if due_ns is None else max(1, -(-due_ns // self.period_ns))
        self._shared.view["image_due"][()] = tick
        self._shared.wake.post()


class LaserEnd(ClockEnd):
    """Commands mirrors and beam of the laser scanner; one client at a time."""

    slot: ClassVar[TimeSlot] = TimeSlot.VSS

    def set_laser(self, beam: LaserBeam) -> None:
        """Command the laser scanner; the mirrors start to move with the next tick, and stop at the ends of travel."""
        self._shared.view["laser_command"][:] = beam.values()

    def laser(self) -> LaserBeam:
        """Return the readings of the scanner's own sensors."""
        return LaserBeam(*self._shared.view["laser"].tolist())
