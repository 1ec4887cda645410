"""Contract of a control law."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core.config import faults
from im_core.errors import ConfigError
from im_mcs.model import CellModel
from im_mcs.planning.trajectories.trajectory import Setpoint


@dataclass(frozen=True)
class ControllerSetup:
    """Setup of a control law.

    Attributes:
        joints: Indices of its joints among all joints, shape (n,).
        period_s: Servo period [s].
        model: Dynamics of all joints.
        torque_limit: Largest torques, shape (n,) [Nm or N].
        q_nominal: A usual position of all joints, for gains that depend on inertia, shape (n,) [rad or m].
        parameters: The ``parameters`` of the configuration.
    """

    joints: NDArray[np.intp]
    period_s: float
    model: CellModel
    torque_limit: NDArray[np.float64]
    q_nominal: NDArray[np.float64]
    parameters: dict[str, Any]


class ControlInput(NamedTuple):
    """Input of a control law in a tick; ``n`` joints of the group, and the whole cell for laws with coupling.

    Attributes:
        q: Measured positions, shape (n,) [rad or m].
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        setpoint: Wanted motion, shape (n,) each.
        gravity: Torques that hold the group against gravity at the measured positions, shape (n,) [Nm or N].
        q_all: Measured positions of all joints, shape (n,) [rad or m].
        wanted_all: Wanted motion of all joints, shape (n,) each; joints that no group holds stand still.
    """

    q: NDArray[np.float64]
    v: NDArray[np.float64]
    setpoint: Setpoint
    gravity: NDArray[np.float64]
    q_all: NDArray[np.float64]
    wanted_all: Setpoint


class Controller(Protocol):
    """A control law for the joints of one group.

    A law for slots of another interface has a method ``velocity`` or ``position`` in place of ``torque``.
    """

    def reset(self) -> None:
        """Start anew: no integral, no past; the arm stands still."""
        ...

    def hold_integral(self, hold: bool) -> None:
        """Freeze accumulated terms, so an arm at rest stays exactly in place."""
        ...

    def torque(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques for the current tick, shape (n,) [Nm or N]; the loop limits the torques."""
        ...


ParametersT = TypeVar("ParametersT", bound=pydantic.BaseModel)


def checked(model: type[ParametersT], parameters: dict[str, Any]) -> ParametersT:
    """Return parameters of a control law as the typed model.

    Raises:
        ConfigError: Some are missing, unknown or out of range; they are named.
    """
    try:
        return model.model_validate(parameters)
    except pydantic.ValidationError as error:
        told = faults(error, model)
        sentence = "; ".join(f"parameter '{fault.field}': {fault.sentence}" for fault in told)
        raise ConfigError(sentence, parameter=told[0].field) from None
