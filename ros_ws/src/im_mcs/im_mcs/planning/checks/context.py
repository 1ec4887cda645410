"""Planning context of a motion."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.planning.trajectories.trajectory import Setpoint

GENERATOR = "trajectory generator"
"""Name of what makes motions, in errors."""
Start = Callable[[], Setpoint]
"""Gives the state that a motion begins with if it begins at the next knot."""


@dataclass(frozen=True)
class PlanContext:
    """Planning context of a motion of one group.

    Attributes:
        model: Kinematics and dynamics.
        limits: Limits of all joints.
        index: Joints of the group among all, shape (n,).
        frames: Wrists that straight lines move: the second one beside the first.
        q_all: Gives the positions of all joints now, shape (n,) [rad or m].
        period_s: Time between two evaluations of a trajectory: a multiple of the servo period [s].
        config: Configuration.
    """

    model: CellModel
    limits: JointLimits
    index: NDArray[np.intp]
    frames: tuple[str, ...]
    q_all: Callable[[], NDArray[np.float64]]
    period_s: float
    config: McsConfig

    @cached_property
    def lead(self) -> NDArray[np.intp]:
        """Return ranks of the joints below the first wrist of the group, among all joints, shape (k,)."""
        return self.below(self.frames[0])

    def below(self, frame: str) -> NDArray[np.intp]:
        """Return ranks of the joints of the group below a frame, among all joints, shape (k,)."""
        return self.index[np.isin(self.index, self.model.joints_below(frame))]

    @cached_property
    def force_sensors(self) -> dict[str, int]:
        """Return the rows of the sensors of the group's wrists among the measured wrenches, by wrist."""
        tips = self.model.cell.devices("force")
        rows = {tips[slot.name]: row for row, slot in enumerate(self.config.wrench_slots)}
        return {wrist: row for wrist, row in rows.items() if wrist in self.frames}

    @cached_property
    def generators(self) -> dict[str, Callable[..., Any]]:
        """Return the configured makers of motions, by kind, each called with context, move and start.

        Raises:
            ConfigError: One cannot be loaded.
        """
        named: dict[str, str] = self.config.planning.generators.model_dump()
        return {kind: plugins.load(name, None, GENERATOR) for kind, name in named.items()}  # type: ignore[misc]
