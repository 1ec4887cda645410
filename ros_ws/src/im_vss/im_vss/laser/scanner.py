"""Drivers of the laser scanner."""

import contextlib
from typing import Protocol

from im_cell.link import LaserBeam, LaserEnd
from im_cell.robot import LaserScanner
from im_core import clock
from im_core.errors import LimitError, LinkError, StateError, WaitTimeoutError

_THERE_RAD = 1e-9
_SPARE_TICKS = 2
_SLICE_S = 0.5
_ATTACH_TIMEOUT_S = 2.0


class Scanner(Protocol):
    """The laser scanner as seen by the Vision Module."""

    def drive(self, beam: LaserBeam, timeout_s: float) -> int:
        """Move the mirrors, set the power, wait for both; return the testbed time [ns].

        Raises:
            ImError: The scanner is not there, or does not get there in time.
        """

    def reading(self) -> LaserBeam:
        """Return the readings of the scanner's own sensors.

        Raises:
            ImError: The scanner is not there.
        """

    def darken(self) -> None:
        """Switch off a beam left on by a former client; do nothing without a scanner."""

    def close(self) -> None:
        """Leave the scanner alone; the beam is dark."""


class LinkedScanner:
    """The scanner at the other end of the testbed link, attached to when first used or darkened."""

    def __init__(self, instance: str, sheet: LaserScanner) -> None:
        """Drive the scanner of an instance of the machine, with the rate of the data sheet."""
        self._instance = instance
        self._sheet = sheet
        self._link: LaserEnd | None = None

    def drive(self, beam: LaserBeam, timeout_s: float) -> int:
        """See :class:`Scanner`.

        Raises:
            LinkError: The testbed is missing.
            WaitTimeoutError: The mirrors were not there in time.
        """
        link = self._attached()
        link.set_laser(beam)
        here = link.laser()
        way = max(abs(beam.mirror1 - here.mirror1), abs(beam.mirror2 - here.mirror2))
        ticks = int(way / (self._sheet.rate * link.period_s)) + _SPARE_TICKS
        deadline = clock.monotonic() + timeout_s
        while True:
            until = link.request_time(ticks)
            link.wait_tick(until, max(deadline - clock.monotonic(), _SLICE_S))
            if _near(link.laser(), beam):
                return until * link.period_ns
            if clock.monotonic() > deadline:
                what = "the testbed to turn the mirrors of the laser scanner to where they shall be"
                raise WaitTimeoutError(what=what, seconds=timeout_s)
            ticks = _SPARE_TICKS

    def reading(self) -> LaserBeam:
        """See :class:`Scanner`.

        Raises:
            LinkError: The testbed is missing.
        """
        return self._attached().laser()

    def darken(self) -> None:
        """See :class:`Scanner`."""
        with contextlib.suppress(LinkError):
            self._attached(0.0).set_laser(LaserBeam())

    def close(self) -> None:
        """See :class:`Scanner`."""
        if self._link is not None:
            self._link.set_laser(LaserBeam())
            self._link.close()
            self._link = None

    def _attached(self, timeout_s: float = _ATTACH_TIMEOUT_S) -> LaserEnd:
        if self._link is not None and not self._link.physics_alive():
            self._link.close()
            self._link = None
        if self._link is None:
            try:
                self._link = LaserEnd.attach(self._instance, timeout_s)
            except LinkError:
                raise LinkError("the testbed is missing: no laser without its physics process") from None
        return self._link


def check_beam(beam: LaserBeam, sheet: LaserScanner) -> LaserBeam:
    """Check whether the scanner can show a beam.

    Raises:
        LimitError: A mirror would turn too far.
        StateError: The power is not between 0 and 1.
    """
    ends = {"mirror1": abs(beam.mirror1) + abs(beam.half_sweep), "mirror2": abs(beam.mirror2)}
    for mirror, angle in ends.items():
        if not angle <= sheet.range:
            value = beam.mirror1 if mirror == "mirror1" else beam.mirror2
            signed = angle if value >= 0.0 else -angle
            raise LimitError(joint=f"{mirror} of the laser scanner", value=signed, limit=sheet.range, unit="rad")
    if not 0.0 <= beam.power <= 1.0:
        raise StateError(f"the power of the laser {beam.power} is not between 0 and 1", power=beam.power)
    return beam


def _near(here: LaserBeam, there: LaserBeam) -> bool:
    return all(abs(a - b) <= _THERE_RAD for a, b in zip(here.values(), there.values(), strict=True))
