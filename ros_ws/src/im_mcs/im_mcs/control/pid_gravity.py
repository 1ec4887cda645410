"""PID positioning with gravity compensation (paper, section 4)."""

import dataclasses
import math

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControlInput, ControllerSetup
from im_mcs.control.pid import Pid


_STICTION_FILTER_S = 0.02


class Feedforward(ConfigModel):
    """Shares of the modelled torques that are fed forward, 0 to 1."""

    gravity: float = pydantic.Field(default=1.0, ge=0, le=1)
    friction: float = pydantic.Field(default=0.0, ge=0, le=1)
    inertia: float = pydantic.Field(default=0.0, ge=0, le=1)
    stiction: float = pydantic.Field(default=0.0, ge=0, lt=1, description="of dry friction, towards the setpoint at rest")
    friction_speed: float = pydantic.Field(default=0.005, gt=0, description="Coulomb friction is full above [rad/s]")


class PidGravity(Pid):
    """PID around the gravity torques of the model; friction and each joint's own inertia may be fed forward too.

    Args:
        setup: As for :class:`im_mcs.control.pid.Pid`, with a further parameter ``feedforward``
            (:class:`Feedforward`).
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = dict(setup.parameters)
        share = Feedforward.model_validate(parameters.pop("feedforward", {}))
        super().__init__(dataclasses.replace(setup, parameters=parameters))
        self._gravity = share.gravity
        self._friction = share.friction
        self._coulomb_positive = setup.model.coulomb_positive[setup.joints]
        self._coulomb_negative = setup.model.coulomb_negative[setup.joints]
        self._viscous = share.friction * setup.model.viscous_friction[setup.joints]
        self._inertia = share.inertia * setup.model.inertia_diagonal(setup.q_nominal)[setup.joints]
        self._friction_speed = share.friction_speed
        self._stiction = share.stiction
        self._breakaway = self.parameters.deadband
        self._smoothing = 1.0 - math.exp(-setup.period_s / _STICTION_FILTER_S)
        self._smooth_error = np.zeros(len(setup.joints))

    def reset(self) -> None:
        """No integral, no past."""
        super().reset()
        self._smooth_error = np.zeros_like(self._smooth_error)

    def feedforward(self, given: ControlInput) -> NDArray[np.float64]:
        """Gravity, friction at the wanted velocity and own inertia at the wanted acceleration, shape (n,)."""
        v, a = given.setpoint.v, given.setpoint.a
        if not self._hold:
            self._smooth_error = self._smooth_error + self._smoothing * (given.setpoint.q - given.q - self._smooth_error)
        # a joint that sticks beside its setpoint is pushed to the verge of breaking loose; the integral does the rest
        excess = np.maximum(np.abs(self._smooth_error) / self._breakaway - 1.0, 0.0)
        push = self._stiction * np.copysign(np.minimum(excess, 1.0), self._smooth_error)
        direction = np.where(v != 0.0, self._friction * np.tanh(v / self._friction_speed), push)
        coulomb = np.where(direction > 0.0, self._coulomb_positive, self._coulomb_negative)
        return self._gravity * given.gravity + coulomb * direction + self._viscous * v + self._inertia * a
