"""Feed-forward of the model's friction: losses of the drives on the way to the joints."""

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControllerSetup
from im_mcs.control.filters import ErrorFeedback, friction_torque


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
    """Coulomb and viscous friction at the wanted velocity: a wanted velocity has no noise and a sure sign."""

    def __init__(self, parameters: FrictionParameters, setup: ControllerSetup) -> None:
        n = len(setup.joints)
        self._share, self._stiction = parameters.friction, parameters.stiction
        self._speed, self._zero = np.full(n, parameters.friction_speed), np.zeros(n)
        self._positive = setup.model.coulomb_positive[setup.joints]
        self._negative = setup.model.coulomb_negative[setup.joints]
        self._viscous = parameters.friction * setup.model.viscous_friction[setup.joints]

    def torque(
        self, v: NDArray[np.float64], feedback: ErrorFeedback | None = None, *, creeping: bool = False
    ) -> NDArray[np.float64]:
        """Friction torques, shape (n,) [Nm or N].

        Args:
            v: Wanted velocities, shape (n,) [rad/s or m/s].
            feedback: Whose error a joint at rest is helped to leave; none: it is not helped.
            creeping: Whether a joint that creeps is helped, too.
        """
        turns = np.tanh(v / self._speed) if np.count_nonzero(v) else self._zero
        share, stiction = self._share, self._stiction
        return friction_torque(
            v, turns, share, stiction, self._positive, self._negative, self._viscous, feedback, creeping
        )
