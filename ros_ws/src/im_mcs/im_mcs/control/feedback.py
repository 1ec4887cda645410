"""Velocity from encoders, and feedback of the position error: proportional, derivative, integral; stillness at rest."""

import math

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel

_SMOOTHING_S = 0.02


class VelocityEstimator:
    """Backward difference through a first-order low pass.

    Args:
        n: Number of signals.
        period_s: Servo period [s].
        bandwidth_rad_s: Corner of the low pass [rad/s].
    """

    def __init__(self, n: int, period_s: float, bandwidth_rad_s: float) -> None:
        # numpy is quicker with two arrays than with a number and an array
        self._gain = np.full(n, (1.0 - math.exp(-bandwidth_rad_s * period_s)) / period_s)
        self._decay = np.full(n, math.exp(-bandwidth_rad_s * period_s))
        self._last: NDArray[np.float64] | None = None
        self._value = np.zeros(n)

    def reset(self) -> None:
        """Forget the past: the next reading is taken as standing still."""
        self._last = None
        self._value = np.zeros_like(self._value)

    def update(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take a reading, shape (n,), and return the derivative, shape (n,).

        That of a signal that is not a number is none either; the first reading after that is taken as standing still.
        """
        if self._last is not None:
            value = self._decay * self._value + self._gain * (x - self._last)
            if not math.isfinite(value.dot(value)):  # quick, and else what is not a number would stay for good
                value = np.where(np.isfinite(x) & ~np.isfinite(value), 0.0, value)
            self._value = value
        self._last = x
        return self._value


class FeedbackParameters(ConfigModel):
    """Gains as the poles of a joint with inertia included, so one line serves joints of any size.

    With inertia ``I`` the gains are ``kp = I w^2``, ``kd = 2 zeta w I``, ``ki = kp w_i``.
    """

    bandwidth_rad_s: float = pydantic.Field(gt=0)
    damping: float = pydantic.Field(gt=0)
    integral_rad_s: float = pydantic.Field(ge=0)
    derivative_bandwidth_rad_s: float = pydantic.Field(gt=0)
    integral_limit: float = pydantic.Field(gt=0, le=1, description="share of the torque limit")
    deadband: float = pydantic.Field(gt=0, description="error that is not integrated [rad or m]")
    rest_deadband: float = pydantic.Field(gt=0, description="change of error that an arm at rest ignores [rad or m]")


class Feedback:
    """Independent PID of each joint; the derivative acts on the error, through a low pass.

    At rest (:meth:`hold`) the integral is frozen and errors that are encoder noise are ignored: the answer does
    not change, friction holds the joint, and it stands exactly still. A disturbance meets the full PID.

    Args:
        parameters: Poles and dead bands.
        inertia: What the poles are multiplied with, shape (n,): inertias for torques, ones for accelerations.
        integral_limit: Bound of the integral part, shape (n,), in the unit of the answer.
        period_s: Servo period [s].

    Attributes:
        deadband: Errors that are not integrated, shape (n,) [rad or m].
        smooth_error: Error without most of its noise, shape (n,) [rad or m].
        holding: Whether the arm is at rest.
    """

    def __init__(
        self,
        parameters: FeedbackParameters,
        inertia: NDArray[np.float64],
        integral_limit: NDArray[np.float64],
        period_s: float,
    ) -> None:
        p = parameters
        self._kp = inertia * p.bandwidth_rad_s**2
        self._kd = 2.0 * p.damping * p.bandwidth_rad_s * inertia
        self._ki_dt = self._kp * p.integral_rad_s * period_s
        self._integral_limit, self._least_integral = integral_limit, -integral_limit
        # numpy is quicker with two arrays than with a number and an array
        self._smoothing = np.full_like(inertia, 1.0 - math.exp(-period_s / _SMOOTHING_S))
        self.deadband = np.full_like(inertia, p.deadband)
        self._least_error = -self.deadband
        self._rest_deadband = np.full_like(inertia, p.rest_deadband)
        self._least_change = -self._rest_deadband
        self._rate = VelocityEstimator(len(inertia), period_s, p.derivative_bandwidth_rad_s)
        self._zero = np.zeros_like(inertia)
        self.reset()

    def reset(self) -> None:
        """No integral, no past."""
        self._rate.reset()
        self._error = self._integral = self.smooth_error = self._zero
        self.holding = False

    def hold(self, hold: bool) -> None:
        """Freeze or free the integral."""
        self.holding = hold

    def update(self, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """The answer to an error, shape (n,)."""
        if self.holding:
            error = self.smooth_error + beyond(error - self.smooth_error, self._least_change, self._rest_deadband)
        else:
            self.smooth_error = self.smooth_error + self._smoothing * (error - self.smooth_error)
        self._error = error
        return self._kp * error + self._kd * self._rate.update(error) + self._integral

    def integrate(self, tau: NDArray[np.float64], torque_limit: NDArray[np.float64]) -> None:
        """Integrate the last error; no wind-up: a joint with saturated torque integrates only back.

        Args:
            tau: Torques that followed from the answer, shape (n,) [Nm or N].
            torque_limit: Largest torques, shape (n,) [Nm or N].
        """
        if self.holding:
            return
        step = self._ki_dt * beyond(self._error, self._least_error, self.deadband)
        free = np.abs(tau) < torque_limit
        if 0 in free.tobytes():
            step = np.where(free | (tau * self._error < 0.0), step, 0.0)
        self._integral = clip(self._integral + step, self._least_integral, self._integral_limit)


def beyond(x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of ``x`` beyond a dead band from ``low`` to ``high``, shape (n,) each."""
    return np.asarray(x - clip(x, low, high))


def clip(
    x: NDArray[np.float64], low: NDArray[np.float64] | float, high: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Clip as :func:`numpy.clip`, shape (n,); for a few numbers numpy's checks take five times as long as the work."""
    return np.minimum(np.maximum(x, low), high)
