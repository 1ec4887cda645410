"""Rest of an arm: the detection, and the measured place."""

from collections import deque
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.configuration import Servo
from im_mcs.protocol.requests import SettleBounds


class RestPhase(StrEnum):
    """Phase of a group on the way to rest."""

    MOVING = "moving"
    SETTLING = "settling"
    MEASURING = "measuring"
    AT_REST = "at rest"


class RestMonitor:
    """Judge of rest from encoder readings alone, tick by tick: the same readings give the same tick.

    *Settling* ends when, over a short window, every joint's mean error is within tolerance and the means of both halves
    agree within what encoder noise explains (three standard deviations). After half the time allowed, an arm may be
    further off, and its halves may differ by more: friction holds it there, or what its jaws hold keeps it trembling,
    and what counts is the position measured, with a variance to which the halves add. *Measuring*
    then averages a window of ``rest_window_ticks`` readings; if its halves disagree the arm has moved, and settling
    begins anew. So it does when the mean of a later short window is off that of the rest by as much: brakes may slip.

    Args:
        resolution: Of the encoders, shape (n,) [rad or m].
        noise: Their standard deviation before quantisation, shape (n,) [rad or m].
        settings: Windows and tolerance.
    """

    def __init__(self, resolution: NDArray[np.float64], noise: NDArray[np.float64], settings: Servo) -> None:
        self._reading_sd = np.sqrt(noise**2 + resolution**2 / 12.0)
        self._quantisation = _quantisation_variance(resolution, noise)
        self._settings = settings
        self._settle_window, self._rest_window = settings.settle.window_ticks, settings.rest_window_ticks
        self.bound(SettleBounds())
        self.restart()

    def bound(self, bounds: SettleBounds) -> None:
        """Judge by these bounds from now on, and by those of the configuration where one is 0."""
        settle, period_s = self._settings.settle, self._settings.period_s
        noise = 3.0 * self._reading_sd / np.sqrt(self._settle_window)
        # of the mean error, at first and late
        allowed = bounds.tolerance or settle.tolerance, bounds.still_tolerance or settle.still_tolerance
        self._tolerance, self._still_tolerance = allowed[0] + noise, allowed[1] + noise
        # by the length of a window, and whether it is late: how much the means of its halves may differ
        self._most_drift = {
            (count, late): 3.0 * np.sqrt(2.0) * (self._reading_sd / np.sqrt(count // 2)) + allowed[late] / 4.0
            for count in (self._settle_window, self._rest_window)
            for late in (False, True)
        }
        self.timeout_s = bounds.timeout_s or settle.timeout_s
        self._timeout_ticks = round(self.timeout_s / period_s)

    def restart(self) -> None:
        """Restart the judgement: the group is about to move, or has lost the hold."""
        self.phase = RestPhase.MOVING
        self.settling_ticks = 0
        self.since_tick = 0
        self.q = np.zeros_like(self._quantisation)
        self.variance = np.zeros_like(self.q)
        self._readings: deque[NDArray[np.float64]] = deque(maxlen=self._settle_window)
        self.last_error = np.zeros_like(self._quantisation)

    @property
    def window(self) -> int:
        """Number of readings averaged at rest [ticks]."""
        return self._rest_window

    @property
    def at_rest(self) -> bool:
        """Whether the rest measurement is complete and holds."""
        return self.phase is RestPhase.AT_REST

    @property
    def timed_out(self) -> bool:
        """Whether settling takes longer than allowed."""
        return self.settling_ticks > self._timeout_ticks

    def worst(self) -> int:
        """Rank of the joint with the largest mean error."""
        return int(np.argmax(np.abs(self.last_error)))

    def update(self, tick: int, q: NDArray[np.float64], target: NDArray[np.float64] | None) -> None:
        """Take a reading of a group with a standing setpoint.

        Args:
            tick: Number of the tick.
            q: Readings, shape (n,).
            target: Setpoint, shape (n,); None where any place will do: while brakes hold, or under a law that yields.
        """
        if self.phase is RestPhase.AT_REST:
            self._watch(q)
            return
        if self.phase is RestPhase.MOVING:
            self._settle()
        self.settling_ticks += 1
        self._readings.append(q)
        if len(self._readings) < (self._readings.maxlen or 0):
            return
        readings = np.array(self._readings)
        mean = _mean(readings)
        if target is not None:
            self.last_error = target - mean
        late = 2 * self.settling_ticks > self._timeout_ticks
        drift = np.abs(_drift(readings))
        if not (drift <= self._most_drift[len(readings), late]).all():
            self._settle()
            return
        if self.phase is RestPhase.SETTLING:
            tolerance = self._still_tolerance if late else self._tolerance
            if target is not None and (np.abs(self.last_error) > tolerance).any():
                return
            self.phase = RestPhase.MEASURING
            self.since_tick = tick
            self._readings = deque(maxlen=self._rest_window)  # readings of the settling do not count
            return
        self.phase = RestPhase.AT_REST
        self.q = mean
        self.variance = readings.var(axis=0, ddof=1) / len(readings) + self._quantisation
        if late:
            self.variance = self.variance + drift**2 / 4.0
        self._readings = deque(maxlen=self._settle_window)

    def _watch(self, q: NDArray[np.float64]) -> None:
        """Restart settling when the arm has left the place of rest; judged once a short window."""
        self._readings.append(q)
        if len(self._readings) == self._settle_window:
            off = np.abs(_mean(np.array(self._readings)) - self.q)
            self._readings.clear()
            if not (off <= self._most_drift[self._settle_window, False]).all():
                self.restart()

    def _settle(self) -> None:
        if self.phase is not RestPhase.SETTLING:
            self._readings = deque(maxlen=self._settle_window)
        self.phase = RestPhase.SETTLING


def _drift(readings: NDArray[np.float64]) -> NDArray[np.float64]:
    half = len(readings) // 2
    return _mean(readings[half:]) - _mean(readings[:half])


def _mean(readings: NDArray[np.float64]) -> NDArray[np.float64]:
    """As ``readings.mean(axis=0)``, in a third of the time for a few readings."""
    return np.asarray(np.add.reduce(readings) / len(readings))


def _quantisation_variance(resolution: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the variance of quantisation in the mean of many readings of a standing arm.

    Noise before a quantiser acts as dither; of the error's Fourier series over one step the first harmonic remains,
    with amplitude ``step / pi * exp(-2 pi^2 sd^2 / step^2)`` (B. Widrow, I. Kollar, "Quantization Noise", 2008, 19);
    without noise the error is uniform over a step.
    """
    dithered = resolution**2 / (2.0 * np.pi**2) * np.exp(-((2.0 * np.pi * noise / resolution) ** 2))
    return np.asarray(np.where(noise > 0.0, dithered, resolution**2 / 12.0))
