"""Limits of position, velocity, acceleration, jerk and torque; always on."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell, Limits
from im_core.errors import ConfigError, DataError, LimitError
from im_mcs.limits.configuration import LimitShares
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.limits.slots import Slot, SlotLimits
from im_mcs.limits.vectors import any_beyond

_OVERSPEED = 1.5
_NONE = SlotLimits()


class JointLimits:
    """Limits of all joints, and sentences about values beyond the limits.

    Attributes:
        lower: Least positions, shape (n,) [rad or m].
        upper: Largest positions.
        motion: Velocity, acceleration and jerk that motions are planned with.
        ceiling: The same of the cell: what no setpoint may pass.
        torque: Largest torques, shape (n,) [Nm or N].
        following_error: Bounds of the following error, shape (n,) [rad or m].

    Args:
        cell: Joints and the cell's limits.
        shares: Shares of them that MCS allows itself.
        slots: All slots; of a limit of a slot's own and the cell's, the narrower one holds.

    Raises:
        ConfigError: They leave a joint no position.
    """

    def __init__(self, cell: Cell, shares: LimitShares, slots: Sequence[Slot] = ()) -> None:
        own = {slot.name: slot.limits for slot in slots if slot.limits is not None}
        narrow = [own.get(name, _NONE) for name in cell.joint_names]
        self.names = cell.joint_names
        self.units = tuple("m" if joint.kind == "prismatic" else "rad" for joint in cell.joints)
        lower = np.maximum(cell.per_joint("limits.lower"), [-np.inf if s.lower is None else s.lower for s in narrow])
        upper = np.minimum(cell.per_joint("limits.upper"), [np.inf if s.upper is None else s.upper for s in narrow])
        speed = np.minimum(cell.per_joint("limits.velocity"), [s.velocity or np.inf for s in narrow])
        self.lower = lower + shares.position_margin
        self.upper = upper - shares.position_margin
        for name, least, largest in zip(self.names, self.lower, self.upper, strict=True):
            if not least < largest:
                text = f"the limits of {name} leave it no position: {least:g} to {largest:g}, margin included"
                raise ConfigError(text, joint=name)
        self.ceiling = MotionLimits(speed, cell.per_joint("limits.acceleration"), cell.per_joint("limits.jerk"))
        self.motion = MotionLimits(
            velocity=speed * shares.velocity,
            acceleration=self.ceiling.acceleration * shares.acceleration,
            jerk=self.ceiling.jerk * shares.jerk,
        )
        torque = np.minimum(cell.per_joint("limits.torque"), [s.torque or np.inf for s in narrow])
        self.torque = torque * shares.torque
        self.following_error = np.array(
            [shares.following_error_m if unit == "m" else shares.following_error_rad for unit in self.units]
        )
        self._speed = speed * _OVERSPEED
        ends = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
        self._middle, self._span, self._ends = (ends[0] + ends[1]) / 2.0, ends[1] - ends[0], ends

    def impossible(self, q: NDArray[np.float64]) -> str:
        """Return a clause on the first reading outside a range by more than half the range; or nothing.

        Args:
            q: Readings of all joints, shape (n,) [rad or m].
        """
        off = q - self._middle
        if not any_beyond(off, self._span):
            return ""
        rank = int(np.flatnonzero(np.abs(off) > self._span)[0])
        lower, upper = (float(end[rank]) for end in self._ends)
        unit = self.units[rank]
        told = f"reading of {self.names[rank]}, {q[rank]:.4g} {unit}, far outside its range"
        return f"{told}, {lower:.4g} to {upper:.4g} {unit}"

    def enforced(self) -> dict[str, Limits]:
        """Return the planning limits of each joint by name; torques with the share of MCS."""
        motion = self.motion
        columns = (self.lower, self.upper, motion.velocity, motion.acceleration, motion.jerk, self.torque)
        fields = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return {name: Limits(**dict(zip(fields, row, strict=True))) for name, row in zip(self.names, rows, strict=True)}

    def check_finite(
        self, index: NDArray[np.intp], values: Sequence[float], where: str, what: str = "position"
    ) -> NDArray[np.float64]:
        """Return values for the joints ``index`` as an array, if finite and as many.

        Args:
            index: Joints, shape (n,).
            values: One for each [in the unit of what they are].
            where: What they are of, for the message.
            what: What they are, for the message.

        Raises:
            DataError: Wrong number, or a value is not finite.
        """
        if len(values) != len(index):
            raise DataError(
                f"{where}: {len(values)} {what}s for {len(index)} joints ({', '.join(self.names[i] for i in index)})",
                given=len(values),
                needed=len(index),
            )
        for i, value in zip(index, values, strict=True):
            if not math.isfinite(value):
                joint = self.names[i]
                raise DataError(f"{where}: {joint}: {what} {value} is not a finite number", joint=joint)
        return np.array(values, dtype=np.float64)

    def check_positions(
        self, index: NDArray[np.intp], values: Sequence[float], where: str, beyond: float = 0.0
    ) -> NDArray[np.float64]:
        """Return positions for the joints ``index`` as an array, if allowed as commanded or measured values.

        Args:
            index: Joints, shape (n,).
            values: One for each [rad or m].
            where: What they are of, for the message.
            beyond: How far out of its range each may be, as a share of it.

        Raises:
            DataError: Wrong number, or a value is not finite.
            LimitError: A position is out of its joint's range; names joint, value, limit and unit.
        """
        positions = self.check_finite(index, values, where)
        margin = beyond * (self.upper[index] - self.lower[index]) if beyond else 0.0
        lower, upper = self.lower[index] - margin, self.upper[index] + margin
        outside = (positions < lower) | (positions > upper)
        if outside.any():
            k = int(np.argmax(outside))
            i, value = index[k], float(positions[k])
            limit = float(lower[k] if value < lower[k] else upper[k])
            what = f"position of {where}"
            raise LimitError(joint=self.names[i], value=value, limit=limit, unit=self.units[i], what=what)
        return positions

    def overspeed(self, v: NDArray[np.float64]) -> LimitError | None:
        """Return the fault of a measured velocity, shape (n,), far beyond any commanded motion."""
        if not any_beyond(v, self._speed):
            return None
        i = int(np.argmax(np.abs(v) > self._speed))
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
        """Return the fault of a following error, shape (n,), beyond ``factor`` times the bound."""
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
