"""PID positioning with gravity compensation (paper, section 4)."""

import dataclasses

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.filters import model_torque
from im_mcs.control.friction import FrictionFeedforward, FrictionParameters
from im_mcs.control.pid import Pid


class Feedforward(FrictionParameters):
    """Shares of the modelled torques fed forward, 0 to 1."""

    gravity: float = pydantic.Field(default=1.0, ge=0, le=1)
    inertia: float = pydantic.Field(default=0.0, ge=0, le=1)


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
        self._model, self._joints = setup.model, setup.joints
        self._gravity, self._inertia = share.gravity, share.inertia
        self._friction = FrictionFeedforward(share, setup)

    def feedforward(self, given: ControlInput) -> NDArray[np.float64]:
        """Gravity, friction at the wanted velocity and own inertia at the wanted acceleration, shape (n,)."""
        setpoint, inertia = given.setpoint, None
        friction = self._friction.torque(setpoint.v, self._feedback)
        if self._inertia > 0.0 and np.count_nonzero(setpoint.a):
            inertia = self._model.inertia_diagonal(given.q_all)[self._joints]
        return model_torque(self._gravity, given.gravity, friction, self._inertia, inertia, setpoint.a)
