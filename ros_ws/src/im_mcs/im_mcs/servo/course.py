"""Courses of joints that a robot's own trajectory controller moves: the motion under way, up to its end.

A course is made where a motion begins, or its rate changes: a pause, a stop, a motion that takes over.
"""

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, StateError
from im_mcs.safety import Reaction, SafetyFinding
from im_mcs.servo.group import ControlledGroup
from im_mcs.testbed import PlannedCourse

_STEP_S = 0.05
_MOST_POINTS = 1900
_SAME = 1e-6


class Courses:
    """Watch over the motions of groups, for courses.

    Args:
        followed: Ranks of the joints whose drivers follow courses.
    """

    def __init__(self, followed: Collection[int]) -> None:
        self._followed = frozenset(followed)
        self._plan: list[object] = []
        self._end: NDArray[np.float64] | None = None

    def update(
        self, engaged: Sequence[ControlledGroup], command: NDArray[np.float64]
    ) -> tuple[PlannedCourse | None, list[SafetyFinding]]:
        """Return a course, if it is another one than before; and findings for motions without one.

        Args:
            engaged: Groups under control.
            command: Commands of this tick, shape (n,) [rad or m].
        """
        groups = [group for group in engaged if self._followed.intersection(group.index.tolist())]
        if not groups:
            self._plan, self._end = [], None
            return None, []
        findings, planners = [], []
        plan: list[object] = []
        for group in groups:
            try:
                plan += group.planner.plan
                planners.append((group.place, group.planner))
            except StateError as error:
                why = f"group '{group.name}': the robot's trajectory controller cannot follow: {error.message}"
                fault = ImError(why, code="course", group=group.name)
                findings.append(SafetyFinding(Reaction.END, fault, (group.name,)))
        if findings or (len(plan) == len(self._plan) and all(a is b for a, b in zip(plan, self._plan, strict=True))):
            return None, findings
        self._plan = plan
        left_s = max(planner.left_s for _, planner in planners)
        if left_s == 0.0 and (self._end is None or np.abs(command - self._end).max() < _SAME):
            return None, []
        step_s = max(_STEP_S, left_s / _MOST_POINTS)
        times = np.append(np.arange(step_s, left_s - step_s / 2.0, step_s), max(left_s, _STEP_S))
        q = np.tile(command, (len(times), 1))
        v = np.zeros_like(q)
        for place, planner in planners:
            states = planner.course(times)
            q[:, place], v[:, place] = states.q, states.v
        v[-1] = 0.0
        self._end = q[-1]
        return PlannedCourse(times, q, v), []
