"""Feedback of the position error: proportional, derivative, integral; stillness at rest."""

import math

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.filters import ErrorFeedback, VelocityEstimator
from im_mcs.limits.vectors import clip

_SMOOTHING_S = 0.02


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

    def feedback(
        self, inertia: NDArray[np.float64], integral_limit: NDArray[np.float64], period_s: float
    ) -> ErrorFeedback:
        """Return the feedback of joints.

        Args:
            inertia: What the poles are multiplied with, shape (n,): inertias for torques, ones for accelerations.
            integral_limit: Bound of the integral part, shape (n,), in the unit of the answer.
            period_s: Servo period [s].
        """
        kp = inertia * self.bandwidth_rad_s**2
        return ErrorFeedback(
            kp,
            2.0 * self.damping * self.bandwidth_rad_s * inertia,
            kp * self.integral_rad_s * period_s,
            integral_limit,
            1.0 - math.exp(-period_s / _SMOOTHING_S),
            self.deadband,
            self.rest_deadband,
            VelocityEstimator(len(inertia), period_s, self.derivative_bandwidth_rad_s),
        )


def beyond(x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of ``x`` beyond a dead band from ``low`` to ``high``, shape (n,) each."""
    return x - clip(x, low, high)
