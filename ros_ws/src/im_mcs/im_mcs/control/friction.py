"""Feed-forward of the model's friction: losses of the drives on the way to the joints."""

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControllerSetup
from im_mcs.control.feedback import Feedback, clip


class FrictionParameters(ConfigModel):
    """Shares of the modelled friction fed forward, 0 to 1."""

    friction: float = pydantic.Field(default=0.0, ge=0, le=1)
    stiction: float = pydantic.Field(
        default=0.0, ge=0, lt=1, description="share of dry friction that is fed forward at rest, towards the setpoint"
    )
    friction_speed: float = pydantic.Field(
        default=0.001, gt=0, description="wanted velocity above which Coulomb friction is full [rad/s or m/s]"
    )


class FrictionFeedforward:
    """Coulomb and viscous friction at the wanted velocity: a wanted velocity has no noise and a sure sign.

    Args:
        parameters: Shares.
        setup: Joints and model.
    """

    def __init__(self, parameters: FrictionParameters, setup: ControllerSetup) -> None:
        n = len(setup.joints)
        # numpy is quicker with two arrays than with a number and an array
        self._share = np.full(n, parameters.friction)
        self._stiction = np.full(n, parameters.stiction)
        self._speed = np.full(n, parameters.friction_speed)
        self._zero, self._one = np.zeros(n), np.ones(n)
        self._positive = setup.model.coulomb_positive[setup.joints]
        self._negative = setup.model.coulomb_negative[setup.joints]
        self._viscous = parameters.friction * setup.model.viscous_friction[setup.joints]
        self._forwards, self._coulomb = bytes(n), self._negative

    def torque(self, v: NDArray[np.float64], feedback: Feedback | None = None) -> NDArray[np.float64]:
        """Friction torques, shape (n,) [Nm or N].

        Args:
            v: Wanted velocities, shape (n,) [rad/s or m/s].
            feedback: Whose error a joint at rest is helped to leave; none: it is not helped.
        """
        moving = np.count_nonzero(v)
        direction = self._share * np.tanh(v / self._speed) if moving else self._zero
        if feedback is not None and not feedback.holding and moving < len(v):
            direction = np.where(v != 0.0, direction, self._push(feedback))
        forwards = direction > self._zero
        if (told := forwards.tobytes()) != self._forwards:  # that changes seldom
            self._forwards, self._coulomb = told, np.where(forwards, self._positive, self._negative)
        return np.asarray(self._coulomb * direction + self._viscous * v)

    def _push(self, feedback: Feedback) -> NDArray[np.float64]:
        """Return the share of dry friction at which a joint stuck beside the setpoint almost breaks loose.

        The integral does the rest. At rest there is no push: friction alone holds the joint, far from the verge.
        """
        error = feedback.smooth_error
        excess = clip(np.abs(error) / feedback.deadband - self._one, self._zero, self._one)
        return np.asarray(self._stiction * np.copysign(excess, error))
