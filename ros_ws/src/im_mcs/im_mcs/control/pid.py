"""PID positioning (paper, section 4)."""

import math

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.velocity import VelocityEstimator

_SMOOTHING_S = 0.02


class PidParameters(ConfigModel):
    """Gains as the poles of a joint of its own inertia, so that one line serves joints of any size.

    With inertia ``I`` the gains are ``kp = I w^2``, ``kd = 2 zeta w I``, ``ki = kp w_i``.
    """

    bandwidth_rad_s: float = pydantic.Field(gt=0)
    damping: float = pydantic.Field(gt=0)
    integral_rad_s: float = pydantic.Field(ge=0)
    derivative_bandwidth_rad_s: float = pydantic.Field(gt=0)
    integral_limit: float = pydantic.Field(gt=0, le=1, description="share of the torque limit")
    deadband: float = pydantic.Field(gt=0, description="error that is not integrated [rad or m]")
    rest_deadband: float = pydantic.Field(gt=0, description="change of error that an arm at rest ignores [rad or m]")


class Pid:
    """Independent joint PID; the derivative acts on the error, through a low pass.

    At rest (:meth:`hold_integral`) the integral is frozen and errors that are encoder noise are ignored: torque does
    not change, friction holds the joint, and it stands exactly still. A disturbance meets the full PID.

    Args:
        setup: Joints, model and parameters (:class:`PidParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        p = self.parameters = checked(PidParameters, setup.parameters)
        n = len(setup.joints)
        inertia = setup.model.inertia_diagonal(setup.q_nominal)[setup.joints]
        self._kp = inertia * p.bandwidth_rad_s**2
        self._kd = 2.0 * p.damping * p.bandwidth_rad_s * inertia
        self._ki_dt = self._kp * p.integral_rad_s * setup.period_s
        self._integral_limit = p.integral_limit * setup.torque_limit
        self._torque_limit = setup.torque_limit
        self._smoothing = 1.0 - math.exp(-setup.period_s / _SMOOTHING_S)
        self._rate = VelocityEstimator(n, setup.period_s, p.derivative_bandwidth_rad_s)
        self._integral = np.zeros(n)
        self._hold = False
        self.smooth_error = np.zeros(n)

    def reset(self) -> None:
        """No integral, no past."""
        self._rate.reset()
        self._integral = np.zeros_like(self._integral)
        self._hold = False
        self.smooth_error = np.zeros_like(self._integral)

    @property
    def holding(self) -> bool:
        """Whether the arm is at rest."""
        return self._hold

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free the integral."""
        self._hold = hold

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """PID torques, shape (n,)."""
        error = given.setpoint.q - given.q
        if self._hold:
            error = self.smooth_error + beyond(error - self.smooth_error, self.parameters.rest_deadband)
        else:
            self.smooth_error = self.smooth_error + self._smoothing * (error - self.smooth_error)
        tau = self.feedforward(given) + self._kp * error + self._kd * self._rate.update(error) + self._integral
        if not self._hold:
            # no wind-up: a saturated joint integrates only back
            free = (np.abs(tau) < self._torque_limit) | (tau * error < 0.0)
            step = np.where(free, self._ki_dt * beyond(error, self.parameters.deadband), 0.0)
            self._integral = np.clip(self._integral + step, -self._integral_limit, self._integral_limit)
        return tau

    def feedforward(self, given: ControlInput) -> NDArray[np.float64]:
        """Torques known beforehand, shape (n,); none here."""
        return np.zeros_like(given.q)


def beyond(x: NDArray[np.float64], deadband: float) -> NDArray[np.float64]:
    """What of ``x`` lies beyond a dead band around 0, shape (n,)."""
    return np.asarray(x - np.clip(x, -deadband, deadband))
