"""Routes of wrists: ends of legs, runs between two rests, and paths."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_mcs.inverse import ArmTracker
from im_mcs.planning.line.geometry import SAME_M, CarriedPath, JointWay, LinePath, Via, WristPath, parameter_length
from im_mcs.protocol.requests import LineMove

# A corner that can only be rounded less than this is rested in: that is quicker, and third derivatives are sound.
_TIGHTEST_M = 1e-3


@dataclass(frozen=True)
class Stop:
    """End of a leg, where a route passes or rests.

    Attributes:
        pose: Of the first wrist in ``world``.
        via: Place on the arc to it.
        q: Positions of all joints, shape (n,), of which those of the first arm count; None: the pose is given.
        relative: Pose of the second wrist in the first.
    """

    pose: pin.SE3
    via: Via
    q: NDArray[np.float64] | None
    relative: pin.SE3


class Route:
    """Route of a wrist through the poses or joint positions of a move, and of a second wrist beside it.

    Args:
        move: The move.
        start: Positions of all joints where it begins, shape (n,) [rad or m].
        lead: Joints that move the first wrist, among all, shape (k,).
        trackers: Kinematics of the first wrist, and of a second one.
        cell: Says which joints are prismatic.
        lever: Way that a rotation of one radian counts as [m].

    Attributes:
        stops: Where it begins, and the end of each leg.
    """

    def __init__(
        self,
        move: LineMove,
        start: NDArray[np.float64],
        lead: NDArray[np.intp],
        trackers: Sequence[ArmTracker],
        cell: Cell,
        lever: float,
    ) -> None:
        self._tracker, self._blend, self._lever = trackers[0], move.blend, lever
        self._levers = np.array([1.0 if joint.kind == "prismatic" else lever for joint in cell.joints])
        self._poses_a_leg = move.poses_a_leg
        first, second = trackers[0].pose(start), trackers[-1].pose(start)
        self.stops = [Stop(first, None, None if move.points is None else start, first.actInv(second))]
        given = [pin.XYZQUATToSE3(np.array(values)) for values in move.poses or ()]
        beside = [pin.XYZQUATToSE3(np.array(values)) for values in move.relative or ()]
        for k in range(move.ends or len(beside)):
            pose, via, q = self.stops[-1].pose, None, None
            if move.points is not None:
                q = start.copy()
                q[lead] = move.points[k]
                pose = self._tracker.pose(q)
            elif given:
                *on_way, pose = given[k * self._poses_a_leg : (k + 1) * self._poses_a_leg]
                via = on_way[0].translation if on_way else None
            self.stops.append(Stop(pose, via, q, beside[k] if beside else self.stops[-1].relative))

    def number(self, end: int) -> int:
        """Return the number of the pose of the move at an end of a leg, from 1."""
        return end * self._poses_a_leg

    def runs(self) -> list[list[int]]:
        """Return the stops passed between two rests, both included, run by run.

        Of stops within half the blend and a tight corner of each other one is passed; the last is reached.
        """

        def length(a: int, b: int) -> float:
            return self._size(self.stops[a], self.stops[b])

        same, last = max(SAME_M, min(self._blend / 2.0, _TIGHTEST_M)), len(self.stops) - 1
        passed = [0]
        for number in range(1, last):
            if length(passed[-1], number) > same:
                passed.append(number)
        while passed[-1] > 0 and length(passed[-1], last) <= same:
            passed.pop()
        if length(passed[-1], last) > SAME_M:
            passed.append(last)
        runs, before = list[list[int]](), 0.0
        for start, end in pairwise(passed):
            after = length(start, end)
            if min(self._blend, before / 2.0, after / 2.0) < _TIGHTEST_M:
                runs.append([start])
            runs[-1].append(end)
            before = after
        return runs

    def path(self, stops: Sequence[Stop], carriers: NDArray[np.float64], *, second: bool) -> WristPath:
        """Return the path of a wrist along some stops.

        Args:
            stops: The stops, no two consecutive ones equal.
            carriers: Positions of the joints that carry its arm at each, shape (m, c) [rad or m].
            second: Whether it is the second wrist.
        """
        lead = self.joint_path(stops, carriers) if stops[0].q is not None else self._line_path(stops, carriers)
        if not second:
            return lead
        relative = [stop.relative for stop in stops]
        return CarriedPath(lead, LinePath(relative, carriers, self._blend, self._lever, sizes=lead.sizes), self._blend)

    def joint_path(self, stops: Sequence[Stop], carriers: NDArray[np.float64]) -> JointWay:
        """Return the path of the first wrist along stops with joint positions; carriers as of :meth:`path`."""
        points = np.array([stop.q for stop in stops])
        return JointWay(self._tracker, points, carriers, self._blend, self._sizes(stops))

    def _line_path(self, stops: Sequence[Stop], carriers: NDArray[np.float64]) -> LinePath:
        poses, vias = [stop.pose for stop in stops], [stop.via for stop in stops[1:]]
        return LinePath(poses, carriers, self._blend, self._lever, vias, self._sizes(stops))

    def _sizes(self, stops: Sequence[Stop]) -> list[float]:
        return [self._size(a, b) for a, b in pairwise(stops)]

    def _size(self, a: Stop, b: Stop) -> float:
        """Return the path parameter from one end of a leg to the next [m]: the longest way of all that moves."""
        ways = (
            parameter_length(a.pose, b.pose, self._lever, b.via),
            parameter_length(a.relative, b.relative, self._lever),
        )
        turned = 0.0 if a.q is None or b.q is None else float((np.abs(b.q - a.q) * self._levers).max())
        return max(*ways, turned)
