"""Courses of joints that a robot's own trajectory controller moves: the motion under way, up to its end.

A course is made where a motion begins, or its rate changes: a pause, a stop, a motion that takes over.
"""

from collections.abc import Collection, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from im_mcs.group import ControlledGroup
from im_mcs.testbed import PlannedCourse

_STEP_S = 0.05
_MOST_POINTS = 1900
_SAME = 1e-6
# time that a robot that had halted by itself is given to come to where the setpoints rest
_CATCH_UP_S, _PATIENCE = 2.0, 3.0


class Courses:
    """Watch over the motions of groups, for courses.

    Args:
        followed: Ranks of the joints whose drivers follow courses.
        near: Following errors with which a robot that had halted counts as there, shape (n,) [rad or m].
        period_s: Servo period [s].
    """

    def __init__(self, followed: Collection[int], near: NDArray[np.float64], period_s: float) -> None:
        self._followed = frozenset(followed)
        self._near, self._period_s = near, period_s
        self._wait_s = 0.0
        self._plan: list[object] = []
        self._end: NDArray[np.float64] | None = None

    def bind(self, groups: Iterable[ControlledGroup]) -> None:
        """Let groups with followed joints take only motions with ends that are known beforehand."""
        for group in groups:
            group.planner.closed = self._follows(group)

    def scale(self, groups: Iterable[ControlledGroup], speed: float, error: NDArray[np.float64]) -> None:
        """Let the setpoints of followed groups be as fast as the robot follows.

        Where the robot had halted by itself, setpoints that have braked ahead of it wait until it is there; after a
        time they go on anyway, and its error is judged.

        Args:
            groups: All groups.
            speed: Share of the wanted speed, 0 to 1.
            error: Following errors of all joints, shape (n,) [rad or m].
        """
        followed = [group for group in groups if self._follows(group)]
        if speed == 0.0:
            self._wait_s = _PATIENCE * _CATCH_UP_S
        elif self._wait_s > 0.0:
            self._wait_s -= speed * self._period_s
            far = np.abs(error) >= self._near
            if not any(far[group.place].any() for group in followed if group.engaged):
                self._wait_s = 0.0
        for group in followed:
            group.rates.set_scaling(0.0 if self._wait_s > 0.0 else speed)

    def update(
        self, engaged: Sequence[ControlledGroup], command: NDArray[np.float64], speed: float
    ) -> PlannedCourse | None:
        """Return a course, if it is another one than before.

        Args:
            engaged: Groups under control.
            command: Commands of this tick, shape (n,) [rad or m].
            speed: Share of the wanted speed with which the robot follows; times of a course are on its clock.
        """
        groups = [group for group in engaged if self._follows(group)]
        if not groups:
            self._plan, self._end = [], None
            return None
        plan = [part for group in groups for part in group.planner.plan]
        if len(plan) == len(self._plan) and all(a is b for a, b in zip(plan, self._plan, strict=True)):
            return None
        self._plan = plan
        left_s = max(group.planner.left_s for group in groups)
        if left_s == 0.0 and (self._end is None or np.abs(command - self._end).max() < _SAME):
            return None
        step_s = max(_STEP_S, left_s / _MOST_POINTS)
        times = np.append(np.arange(step_s, left_s - step_s / 2.0, step_s), max(left_s, _STEP_S))
        q = np.tile(command, (len(times), 1))
        v = np.zeros_like(q)
        for group in groups:
            states = group.planner.course(times)
            q[:, group.place], v[:, group.place] = states.q, states.v
        v[-1] = 0.0
        self._end = q[-1]
        if speed == 0.0:  # later on, the robot takes its time to where the setpoints have braked to
            return PlannedCourse(times + _CATCH_UP_S, q, v)
        return PlannedCourse(times * speed, q, v / speed)

    def _follows(self, group: ControlledGroup) -> bool:
        return bool(self._followed.intersection(group.index.tolist()))
