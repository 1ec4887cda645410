"""Contract of a control law, and how one is loaded by name."""

import importlib
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, cast

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.errors import ConfigError
from im_mcs.model import Model
from im_mcs.planning.setpoint import Setpoint


@dataclass(frozen=True)
class ControllerSetup:
    """What a control law is made from.

    Attributes:
        joints: Indices of its joints among all joints, shape (n,).
        period_s: Servo period [s].
        model: Dynamics of all joints.
        torque_limit: Largest torques, shape (n,) [Nm or N].
        q_nominal: A usual position of all joints, for gains that depend on inertia, shape (18,) [rad or m].
        parameters: The ``parameters`` of the configuration.
    """

    joints: NDArray[np.intp]
    period_s: float
    model: Model
    torque_limit: NDArray[np.float64]
    q_nominal: NDArray[np.float64]
    parameters: dict[str, Any]


@dataclass(frozen=True)
class ControlInput:
    """What a control law sees in a tick; ``n`` joints of its group.

    Attributes:
        q: Measured positions, shape (n,) [rad or m].
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        setpoint: Wanted motion, shape (n,) each.
        gravity: Torques that hold the group against gravity at the measured positions, shape (n,) [Nm or N].
    """

    q: NDArray[np.float64]
    v: NDArray[np.float64]
    setpoint: Setpoint
    gravity: NDArray[np.float64]


class Controller(Protocol):
    """A control law for the joints of one group."""

    def reset(self) -> None:
        """Start anew: no integral, no past; the arm stands still."""
        ...

    def hold_integral(self, hold: bool) -> None:
        """Freeze what accumulates, so that an arm at rest stays exactly where it is."""
        ...

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Torques for this tick, shape (n,) [Nm or N]; the loop limits them."""
        ...


ParametersT = TypeVar("ParametersT", bound=pydantic.BaseModel)


def checked(model: type[ParametersT], parameters: dict[str, Any]) -> ParametersT:
    """Parameters of a control law as its typed model.

    Raises:
        ConfigError: One is missing, unknown or out of range; it is named.
    """
    try:
        return model.model_validate(parameters)
    except pydantic.ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(str(part) for part in fault["loc"])
        raise ConfigError(f"controller parameter '{where}': {fault['msg']}", parameter=where) from None


def load_controller(name: str, setup: ControllerSetup) -> Controller:
    """Make the control law that the configuration names ``module:Class``.

    Raises:
        ConfigError: There is no such module or class, or it refuses its parameters.
    """
    module_name, _, class_name = name.partition(":")
    try:
        factory = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(
            f"controller '{name}' cannot be loaded: {error}; it is written module:Class", controller=name
        ) from None
    return cast(Controller, factory(setup))
