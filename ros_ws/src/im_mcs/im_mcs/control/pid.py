"""PID positioning (paper, section 4)."""

import numpy as np
from numpy.typing import NDArray

from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.feedback import FeedbackParameters

_MOST_COUPLED = 3.0


class Pid:
    """Independent joint PID.

    The poles are those of a joint whose neighbours stand still. Neighbours that give way leave a joint less inertia to
    push against: some motion of all joints together has a bandwidth larger by the root of the largest eigenvalue of
    ``M^-1 diag(M)``. Beyond an eigenvalue of 3, as of long chains without gears, all gains are smaller by as much.

    Args:
        setup: Joints, model and parameters (:class:`im_mcs.control.feedback.FeedbackParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = checked(FeedbackParameters, setup.parameters)
        self._torque_limit = setup.torque_limit
        whole = setup.model.inertia(setup.q_nominal)[np.ix_(setup.joints, setup.joints)]
        inertia = whole.diagonal()
        coupled = float(np.linalg.eigvals(np.linalg.solve(whole, np.diag(inertia))).real.max())
        inertia = inertia * min(1.0, _MOST_COUPLED / coupled)
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
