"""Computed torque: inverse dynamics make every joint a double integrator, which a PID then positions."""

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.feedback import FeedbackParameters
from im_mcs.control.friction import FrictionFeedforward, FrictionParameters


class ComputedTorqueParameters(FeedbackParameters):
    """Poles of the error, and shares of friction."""

    feedforward: FrictionParameters = pydantic.Field(default_factory=FrictionParameters)


class ComputedTorque:
    """``tau = M(q) (a_d + kd e' + kp e + ki integral(e)) + C(q, v_d) v_d + g(q) + friction(v_d)``.

    B. Siciliano and others, "Robotics" (2009), 8.5.2, with two changes for encoders that are all there is to measure
    with: Coriolis and friction torques are those of the wanted velocity, which has neither noise nor lag. Joints of
    other groups enter with the accelerations that are wanted of them.

    Args:
        setup: Joints, model and parameters (:class:`ComputedTorqueParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = checked(ComputedTorqueParameters, setup.parameters)
        self._model, self._joints = setup.model, setup.joints
        self._torque_limit = setup.torque_limit
        inertia = setup.model.inertia_diagonal(setup.q_nominal)[setup.joints]
        limit = parameters.integral_limit * setup.torque_limit / inertia
        self._feedback = parameters.feedback(np.ones(len(setup.joints)), limit, setup.period_s)
        self._friction = FrictionFeedforward(parameters.feedforward, setup)

    def reset(self) -> None:
        """No integral, no past."""
        self._feedback.reset()

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free the integral."""
        self._feedback.hold(hold)

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques of the wanted motion and of the error's feedback, shape (n,)."""
        acceleration = given.wanted_all.a.copy()
        acceleration[self._joints] += self._feedback.update(given.setpoint.q - given.q)
        tau = self._model.inverse_dynamics(given.q_all, given.wanted_all.v, acceleration)[self._joints]
        tau = tau + self._friction.torque(given.setpoint.v, self._feedback, creeping=True)
        self._feedback.integrate(tau, self._torque_limit)
        return tau
