"""Laws for robots that close the loop of a joint themselves: the setpoints go out as positions, or as velocities."""

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import Model as ConfigModel
from im_mcs.control.controller import ControlInput, ControllerSetup, checked
from im_mcs.control.feedback import beyond


class PositionParameters(ConfigModel):
    """Parameters of a law without any."""


class SetpointPosition:
    """Positions as the planner wants them; the robot's own loop follows.

    Args:
        setup: Joints and parameters (:class:`PositionParameters`).

    Raises:
        ConfigError: A parameter is given.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        checked(PositionParameters, setup.parameters)

    def reset(self) -> None:
        """No past."""

    def hold_integral(self, hold: bool) -> None:
        """Nothing accumulates."""

    def position(self, given: ControlInput) -> NDArray[np.float64]:
        """Return the positions of the setpoint, shape (n,) [rad or m]."""
        return given.setpoint.q


class VelocityParameters(ConfigModel):
    """Gain of the position error."""

    gain_1_s: float = pydantic.Field(gt=0, description="velocity for an error of position [1/s]")
    rest_deadband: float = pydantic.Field(gt=0, description="error that an arm at rest ignores [rad or m]")


class SetpointVelocity:
    """``v = v_d + k (q_d - q)``: velocities as the planner wants them, and a term that ends errors of position.

    B. Siciliano and others, "Robotics" (2009), 8.3: kinematic control in joint space.

    Args:
        setup: Joints and parameters (:class:`VelocityParameters`).

    Raises:
        ConfigError: A parameter is missing, unknown or out of range.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        parameters = checked(VelocityParameters, setup.parameters)
        self._gain, self._band = parameters.gain_1_s, np.full(len(setup.joints), parameters.rest_deadband)
        self._holding = False

    def reset(self) -> None:
        """No past; the arm stands still."""
        self._holding = False

    def hold_integral(self, hold: bool) -> None:
        """At rest, ignore errors that are noise of encoders."""
        self._holding = hold

    def velocity(self, given: ControlInput) -> NDArray[np.float64]:
        """Return velocities, shape (n,) [rad/s or m/s]."""
        error = given.setpoint.q - given.q
        if self._holding:
            error = beyond(error, -self._band, self._band)
        return np.asarray(given.setpoint.v + self._gain * error)
