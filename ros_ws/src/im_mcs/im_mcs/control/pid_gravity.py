"""PID positioning with gravity compensation (paper, section 4)."""

import dataclasses

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.pid import Pid


class Feedforward(ConfigModel):
    """Shares of the modelled torques that are fed forward, 0 to 1."""

    gravity: float = pydantic.Field(default=1.0, ge=0, le=1)
    friction: float = pydantic.Field(default=0.0, ge=0, le=1)
    inertia: float = pydantic.Field(default=0.0, ge=0, le=1)
    stiction: float = pydantic.Field(
        default=0.0, ge=0, lt=1, description="of dry friction, towards the setpoint at rest"
    )
    friction_speed: float = pydantic.Field(default=0.005, gt=0, description="Coulomb friction is full above [rad/s]")


class PidGravity(Pid):
    """PID around the gravity torques of the model; friction and each joint's own inertia may be fed forward too.

    Args:
        setup: As for :class:`im_mcs.control.pid.Pid`, with a further parameter ``feedforward``
            (:class:`Feedforward`).
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = dict(setup.parameters)
        share = checked(Feedforward, parameters.pop("feedforward", {}))
        super().__init__(dataclasses.replace(setup, parameters=parameters))
        self._gravity = share.gravity
        self._friction = share.friction
        self._coulomb_positive = setup.model.coulomb_positive[setup.joints]
        self._coulomb_negative = setup.model.coulomb_negative[setup.joints]
        self._viscous = share.friction * setup.model.viscous_friction[setup.joints]
        self._inertia = share.inertia * setup.model.inertia_diagonal(setup.q_nominal)[setup.joints]
        self._friction_speed = share.friction_speed
        self._stiction = share.stiction

    def feedforward(self, given: ControlInput) -> NDArray[np.float64]:
        """Gravity, friction at the wanted velocity and own inertia at the wanted acceleration, shape (n,)."""
        v, a = given.setpoint.v, given.setpoint.a
        direction = np.where(v != 0.0, self._friction * np.tanh(v / self._friction_speed), self._push())
        coulomb = np.where(direction > 0.0, self._coulomb_positive, self._coulomb_negative)
        known = self._gravity * given.gravity + coulomb * direction + self._viscous * v + self._inertia * a
        return np.asarray(known)

    def _push(self) -> NDArray[np.float64]:
        """Share of dry friction that brings a joint stuck beside its setpoint to the verge of breaking loose.

        The integral does the rest. At rest there is no push: friction alone holds the joint, far from the verge.
        """
        if self.holding:
            return np.zeros_like(self.smooth_error)
        excess = np.clip(np.abs(self.smooth_error) / self.parameters.deadband - 1.0, 0.0, 1.0)
        return np.asarray(self._stiction * np.copysign(excess, self.smooth_error))
