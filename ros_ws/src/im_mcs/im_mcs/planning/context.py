"""What a motion is planned with, and what prepares one in bounded slices."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.setpoint import Setpoint
from im_mcs.planning.trajectory import Trajectory

if TYPE_CHECKING:
    from im_mcs.config import McsConfig
    from im_mcs.limits import JointLimits
    from im_mcs.model import Model

Start = Callable[[], Setpoint]
"""Gives the state that a motion begins with if it begins at the next knot."""


@dataclass(frozen=True)
class PlanContext:
    """What a motion of one group is planned with.

    Attributes:
        model: Kinematics and dynamics.
        limits: Limits of all joints.
        index: Joints of the group among all, shape (n,).
        frame: Frame whose pose the group controls, if it has one.
        q_all: Gives the positions of all joints now, shape (18,) [rad or m].
        period_s: Time between two evaluations of a trajectory: a multiple of the servo period [s].
        config: Configuration.
    """

    model: "Model"
    limits: "JointLimits"
    index: NDArray[np.intp]
    frame: str | None
    q_all: Callable[[], NDArray[np.float64]]
    period_s: float
    config: "McsConfig"


class Preparation(Protocol):
    """A motion being prepared; nothing moves meanwhile because of it."""

    def step(self) -> Trajectory | None:
        """Do one slice of the work, of about 0.3 ms, counted in steps and never in time, so that it can be repeated.

        Returns:
            The trajectory (a :class:`~im_mcs.planning.polynomial.PiecewisePolynomial`), or None: call again next tick.

        Raises:
            ImError: The motion is refused.
        """
        ...
