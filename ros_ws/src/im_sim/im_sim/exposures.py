"""Exposures: the view of a shutter between two ticks."""

import numpy as np
from numpy.typing import NDArray

from im_cell.link import ExposureRequest, HostEnd, LaserBeam
from im_sim.laser import Laser


class Exposures:
    """Server of one exposure request after the other; a new request replaces a request without a client."""

    def __init__(self, link: HostEnd) -> None:
        self._link = link
        self._request: ExposureRequest | None = None
        self._start = 0
        self._q_sum = np.zeros(link.n_joints)
        self._light_sum = np.zeros(len(link.light_names))
        self._laser_sum = np.zeros(4)
        self._lights = link.lights()

    def begin_tick(self, tick: int) -> None:
        """Open the shutter for a waiting request."""
        request = self._link.pending_exposure()
        if request is not None or self._request is not None:
            self._lights = self._link.lights()
        if request is None or (self._request is not None and request.request == self._request.request):
            return
        self._request, self._start = request, tick
        self._q_sum[:] = 0.0
        self._light_sum[:] = 0.0
        self._laser_sum[:] = 0.0

    def end_tick(self, tick: int, q_before: NDArray[np.float64], q_after: NDArray[np.float64], laser: Laser) -> None:
        """Account for the tick up to ``tick``.

        Args:
            tick: The tick that has begun.
            q_before: Joint positions before it, shape (n,) [rad or m].
            q_after: Joint positions after it, shape (n,) [rad or m].
            laser: The laser scanner.
        """
        request = self._request
        if request is None:
            return
        self._q_sum += 0.5 * (q_before + q_after)
        if not request.blank_light:
            self._light_sum += self._lights
        mirror1, mirror2, half_sweep, power = laser.true.values()
        self._laser_sum += (mirror1, mirror2, half_sweep, 0.0 if request.blank_laser else power)
        if tick - self._start >= request.ticks:
            laser_mean = LaserBeam(*(self._laser_sum / request.ticks).tolist())
            self._link.finish_exposure(
                request, self._start, tick, self._q_sum / request.ticks, self._light_sum / request.ticks, laser_mean
            )
            self._request = None
