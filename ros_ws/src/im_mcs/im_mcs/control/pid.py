"""PID positioning (paper, section 4)."""

import numpy as np
from numpy.typing import NDArray

from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.feedback import FeedbackParameters


class Pid:
    """Independent joint PID.

    Args:
        setup: Joints, model and parameters (:class:`im_mcs.control.feedback.FeedbackParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = checked(FeedbackParameters, setup.parameters)
        self._torque_limit = setup.torque_limit
        inertia = setup.model.inertia_diagonal(setup.q_nominal)[setup.joints]
        limit = parameters.integral_limit * setup.torque_limit
        self._feedback = parameters.feedback(inertia, limit, setup.period_s)

    def reset(self) -> None:
        """No integral, no past."""
        self._feedback.reset()

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free the integral."""
        self._feedback.hold(hold)

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Return PID torques, shape (n,)."""
        tau = self._feedback.update(given.setpoint.q - given.q) + self.feedforward(given)
        self._feedback.integrate(tau, self._torque_limit)
        return tau

    def feedforward(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques known beforehand, shape (n,); none here."""
        return np.zeros_like(given.q)
