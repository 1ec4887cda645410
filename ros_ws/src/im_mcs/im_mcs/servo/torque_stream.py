"""Torques driven by a client itself: the motion control layer, open to the owner of the slots."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, LimitError, StateError
from im_mcs.limits import JointLimits
from im_mcs.safety.braking import stopping_position
from im_mcs.servo.group import ControlledGroup, Goal

Ended = tuple[ControlledGroup, Goal, ImError]


@dataclass
class _Drive:
    group: ControlledGroup
    goal: Goal
    owner: str
    lease_s: float
    tau: NDArray[np.float64]
    silent_ticks: int = 0


class TorqueDriving:
    """Groups whose torques come from a client, as long as it renews its lease and the joints can still be stopped.

    Args:
        limits: Limits of all joints.
        period_s: Servo period [s].
    """

    def __init__(self, limits: JointLimits, period_s: float) -> None:
        self._limits = limits
        self._period_s = period_s
        self._drives: dict[str, _Drive] = {}

    def __bool__(self) -> bool:
        """Whether any group is driven."""
        return bool(self._drives)

    def torque(self, group: str) -> NDArray[np.float64] | None:
        """Torques wanted of a group, shape (n,) [Nm or N]; None if it is not driven."""
        drive = self._drives.get(group)
        return None if drive is None else drive.tau

    def goal(self, group: str) -> Goal | None:
        """The goal of a driven group."""
        drive = self._drives.get(group)
        return None if drive is None else drive.goal

    def require_free(self, group: str) -> None:
        """Check that a group is not driven.

        Raises:
            StateError: It is.
        """
        goal = self.goal(group)
        if goal is not None:
            raise StateError(f"group '{group}' is driven by torques (goal {goal.id}); cancel that first", group=group)

    def stream(self, group: ControlledGroup, goal: Goal, arguments: Mapping[str, Any]) -> bool:
        """Take the newest torques; the first ones open the goal, later ones renew torques and lease.

        Returns:
            Whether they opened it.

        Raises:
            StateError: The group follows a motion.
            DataError: A wrong size, or a value that is not finite.
        """
        torques, lease_s = arguments["torques"], float(arguments["lease_s"])
        self._limits.check_finite(group.index, torques, "stream", "torque")
        drive = self._drives.get(group.name)
        if drive is None:
            if group.goals:
                raise StateError(
                    f"group '{group.name}' is moving (goal {group.goals[0].id}); wait for its end or cancel it",
                    group=group.name,
                )
            self._drives[group.name] = _Drive(
                group, goal, arguments["owner"], lease_s, np.array(torques, dtype=np.float64)
            )
            return True
        drive.tau, drive.lease_s, drive.silent_ticks = np.array(torques, dtype=np.float64), lease_s, 0
        return False

    def cancel(self, goal_id: int) -> str | None:
        """The group that the goal drives, if there is one."""
        return next((name for name, drive in self._drives.items() if drive.goal.id == goal_id), None)

    def end(self, fault: ImError, groups: Iterable[str] | None = None) -> list[Ended]:
        """Let the laws take over again; all groups if none are named."""
        names = list(self._drives) if groups is None else [name for name in groups if name in self._drives]
        drives = [self._drives.pop(name) for name in names]
        return [(drive.group, drive.goal, fault) for drive in drives]

    def tick(self, q: NDArray[np.float64], v: NDArray[np.float64], tick: int) -> list[Ended]:
        """Judge leases, and whether every driven joint could still be stopped within its range.

        Args:
            q: Measured positions of all joints.
            v: Estimated velocities of all joints.
            tick: Number of the tick.
        """
        ended = []
        for name, drive in list(self._drives.items()):
            drive.silent_ticks += 1
            fault = self._lapsed(drive) or self._beyond(drive.group.index, q, v, tick)
            if fault is not None:
                ended += self.end(fault, (name,))
        return ended

    def _lapsed(self, drive: _Drive) -> ImError | None:
        if drive.silent_ticks * self._period_s <= drive.lease_s:
            return None
        who = f"'{drive.owner}'" if drive.owner else "the sender"
        return ImError(f"{who} has sent no torques for {drive.lease_s:g} s, its lease", code="lease", owner=drive.owner)

    def _beyond(
        self, index: NDArray[np.intp], q: NDArray[np.float64], v: NDArray[np.float64], tick: int
    ) -> ImError | None:
        limits = self._limits
        rest = stopping_position(q, v, np.zeros_like(v), limits.motion)[index]
        lower = np.minimum(limits.lower, q)[index]
        upper = np.maximum(limits.upper, q)[index]
        outside = (rest < lower) | (rest > upper)
        if outside.any():
            k = int(np.argmax(outside))
            i = int(index[k])
            limit = limits.lower[i] if v[i] < 0.0 else limits.upper[i]
            what = f"position at which it could stop at tick {tick}"
            return _limit_fault(limits, i, float(rest[k]), float(limit), limits.units[i], what)
        fast = np.abs(v[index]) > limits.ceiling.velocity[index]
        if fast.any():
            i = int(index[int(np.argmax(fast))])
            what = f"velocity at tick {tick}"
            return _limit_fault(limits, i, float(v[i]), float(limits.ceiling.velocity[i]), f"{limits.units[i]}/s", what)
        return None


def _limit_fault(limits: JointLimits, i: int, value: float, limit: float, unit: str, what: str) -> LimitError:
    return LimitError(joint=limits.names[i], value=value, limit=limit, unit=unit, what=what)
