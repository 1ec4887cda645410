"""Limits of position, velocity, acceleration, jerk and torque; always on."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, LimitError
from im_mcs.config import Limits as LimitShares
from im_mcs.model import Model
from im_mcs.planning.joint_path import MotionLimits

_OVERSPEED = 1.5


class JointLimits:
    """Limits of all joints, and sentences about values that break them.

    Args:
        model: Joints and the cell's limits.
        shares: Shares of them that MCS allows itself.
    """

    def __init__(self, model: Model, shares: LimitShares) -> None:
        cell = model.cell
        self.names = model.names
        self.units = tuple("m" if joint.kind == "prismatic" else "rad" for joint in cell.joints)
        self.lower = cell.per_joint("limits.lower") + shares.position_margin
        self.upper = cell.per_joint("limits.upper") - shares.position_margin
        self.motion = MotionLimits(
            velocity=cell.per_joint("limits.velocity") * shares.velocity,
            acceleration=cell.per_joint("limits.acceleration") * shares.acceleration,
            jerk=cell.per_joint("limits.jerk") * shares.jerk,
        )
        self.torque = cell.per_joint("limits.torque") * shares.torque
        self.following_error = np.array(
            [shares.following_error_m if unit == "m" else shares.following_error_rad for unit in self.units]
        )
        self._speed = cell.per_joint("limits.velocity") * _OVERSPEED

    def check_finite(self, index: NDArray[np.intp], values: Sequence[float], where: str) -> NDArray[np.float64]:
        """Positions for the joints ``index`` as an array, if they are as many and finite.

        Args:
            index: Joints, shape (n,).
            values: Their positions [rad or m].
            where: What the positions are of, for the message.

        Raises:
            DataError: Wrong number, or a value is not finite.
        """
        if len(values) != len(index):
            raise DataError(
                f"{where}: {len(values)} positions for {len(index)} joints ({', '.join(self.names[i] for i in index)})",
                given=len(values),
                needed=len(index),
            )
        for i, value in zip(index, values, strict=True):
            if not math.isfinite(value):
                joint = self.names[i]
                raise DataError(f"{where}: {joint}: position {value} is not a finite number", joint=joint)
        return np.array(values, dtype=np.float64)

    def check_positions(self, index: NDArray[np.intp], values: Sequence[float], where: str) -> NDArray[np.float64]:
        """Positions for the joints ``index`` as an array, if they may be commanded.

        Raises:
            DataError: Wrong number, or a value is not finite.
            LimitError: A position is out of its joint's range; names joint, value, limit and unit.
        """
        positions = self.check_finite(index, values, where)
        outside = (positions < self.lower[index]) | (positions > self.upper[index])
        if outside.any():
            k = int(np.argmax(outside))
            i, value = index[k], float(positions[k])
            limit = float(self.lower[i] if value < self.lower[i] else self.upper[i])
            what = f"position of {where}"
            raise LimitError(joint=self.names[i], value=value, limit=limit, unit=self.units[i], what=what)
        return positions

    def clip_torque(self, tau: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
        """Torques within their limits, shape (18,), and how many were cut."""
        clipped = np.minimum(np.maximum(tau, -self.torque), self.torque)
        return clipped, int(np.count_nonzero(clipped != tau))

    def overspeed(self, v: NDArray[np.float64]) -> LimitError | None:
        """The fault if a measured velocity, shape (18,), is far beyond what any motion commands."""
        beyond = np.abs(v) > self._speed
        if not beyond.any():
            return None
        i = int(np.argmax(beyond))
        return LimitError(
            joint=self.names[i],
            value=float(v[i]),
            limit=float(self._speed[i]),
            unit=f"{self.units[i]}/s",
            what="velocity",
        )

    def following(
        self, index: NDArray[np.intp], error: NDArray[np.float64], factor: float, tick: int
    ) -> LimitError | None:
        """The fault if a following error, shape (n,), is beyond ``factor`` times its bound."""
        bound = self.following_error[index] * factor
        beyond = np.abs(error) > bound
        if not beyond.any():
            return None
        i = int(np.argmax(beyond))
        fault = LimitError(
            joint=self.names[index[i]],
            value=float(error[i]),
            limit=float(bound[i]),
            unit=self.units[index[i]],
            what=f"following error at tick {tick}",
        )
        fault.facts["tick"] = tick
        return fault
