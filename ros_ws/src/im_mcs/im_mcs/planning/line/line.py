"""Straight lines of the wrist in SE(3) (paper, section 4), prepared in bounded slices."""

from collections.abc import Generator
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import StateError
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.envelope import slowdown
from im_mcs.planning.line.carriers import CarrierChoice
from im_mcs.planning.line.curve import JointCurve, LineCurve
from im_mcs.planning.line.geometry import LinePath, parameter_length
from im_mcs.planning.line.speed import Profile, fit
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.protocol.requests import LineMove

# Quintics in time between knots this far apart follow curve and profile to far less than a micrometre [s].
_KNOT_S = 0.02
_SAME_M = 1e-9
_PIECES_A_STEP = 100
# rounding must not bring a limit back that a slower motion just keeps
_SLOWER = 1.0 + 1e-9


class LinePreparation:
    """Makes the motion that takes a wrist along straight lines through poses.

    Joints are found by inverse kinematics along the line, at places as close as it takes to keep the line, and joined
    by quintics. A one-dimensional profile of the path parameter sets the speed, with one bound of velocity,
    acceleration and jerk for all lines between two rests, and one speed for each rounded corner: the largest with
    which no joint passes its limits. That is time-optimal only where the arm's Jacobian changes little on the way.

    A group that carries its arm on joints of its own (a cart) moves these too where that helps, see
    :class:`~im_mcs.planning.line.carriers.CarrierChoice`.

    Args:
        context: What to plan with.
        start: Where the group is, at rest, shape (n,) [rad or m].
        move: Poses of the wrist in ``world``, its speed, and how corners are rounded.

    Raises:
        StateError: The group has no wrist, or not all joints of its arm.
    """

    def __init__(self, context: PlanContext, start: NDArray[np.float64], move: LineMove) -> None:
        if context.frame is None:
            raise StateError("the group has no wrist; a straight line needs one")
        self._context, self._frame = context, context.frame
        self._settings = context.config.planning.line
        self._arm = Arm(context.model, context.frame)
        missing = [context.model.names[i] for i in self._arm.joints if i not in context.index]
        if missing:
            raise StateError(f"a straight line of {context.frame} needs {', '.join(missing)}, not in the group")
        self._tracker = ArmTracker(context.model, self._arm, context.frame)
        self._start = context.q_all().copy()
        self._start[context.index] = start
        self._poses = [pin.XYZQUATToSE3(np.array(values)) for values in move.poses]
        self._speed, self._blend = move.speed or np.inf, move.blend
        self._choice = CarrierChoice(
            context.model,
            context.limits,
            context.index,
            self._arm,
            self._tracker,
            context.frame,
            self._settings.rotation_lever_m,
        )
        self._work = self._prepare()

    def step(self) -> PiecewisePolynomial | None:
        """One slice: one place of a line, or one round of its speed.

        Raises:
            LimitError: A joint would pass its range; names the joint, the pose and the place on the line.
            ImError: A singularity is on the way (code ``singular``), or the line leaves the arm's reach
                (``unreachable``).
        """
        try:
            next(self._work)
        except StopIteration as done:
            trajectory: PiecewisePolynomial = done.value
            return trajectory
        return None

    def _prepare(self) -> Generator[None, None, PiecewisePolynomial]:
        q, parts = self._start, list[PiecewisePolynomial]()
        limits = self._context.limits.motion.of(self._context.index)
        for numbers in self._runs():
            poses = [self._poses[number - 1] for number in numbers]
            carriers, there = [q[self._arm.carriers]], q
            for pose in poses:
                there = yield from self._choice.choose(there, pose)
                carriers.append(there[self._arm.carriers])
            corners = [self._tracker.pose(q), *poses]
            path = LinePath(corners, np.array(carriers), self._blend, self._settings.rotation_lever_m)
            curve, q = yield from self._line_curve(path, numbers).walk(q)
            profile = yield from fit(curve, path.size, limits, self._fastest(path), path.rounded)
            parts.append((yield from self._timed(path, curve, profile, numbers, limits)))
        if not parts:
            return PiecewisePolynomial.standing(q[self._context.index])
        return parts[0].followed_by(parts[1:])

    def _runs(self) -> list[list[int]]:
        """Numbers of the poses that are passed without rest in between: all of them, or each by itself."""
        lever = self._settings.rotation_lever_m
        poses = [self._tracker.pose(self._start), *self._poses]
        different = [k for k, (a, b) in enumerate(pairwise(poses), start=1) if parameter_length(a, b, lever) > _SAME_M]
        return [different] if self._blend > 0.0 and different else [[number] for number in different]

    def _line_curve(self, path: LinePath, numbers: list[int]) -> LineCurve:
        return LineCurve(
            self._tracker,
            self._arm,
            self._context.limits,
            self._context.index,
            path,
            self._frame,
            self._settings.singular_value,
            self._settings.deviation_m,
            self._settings.rotation_lever_m,
            numbers,
        )

    def _fastest(self, path: LinePath) -> float:
        """Velocity of the path parameter at which the wrist's origin has the wanted speed on its fastest line [m/s]."""
        share = max(way / (b - a) for way, (a, b) in zip(path.lengths, pairwise(path.corners), strict=True))
        return self._speed / share if share > 0.0 else np.inf

    def _timed(
        self, path: LinePath, curve: JointCurve, profile: Profile, numbers: list[int], limits: MotionLimits
    ) -> Generator[None, None, PiecewisePolynomial]:
        """The motion between two rests, slowed down as a whole by what its quintics go beyond limits between knots."""
        motion = profile.sampled(_KNOT_S, path.edges[1:-1])
        yield
        q, d1, d2, _ = curve.at(np.minimum(motion.s, path.size))
        v, a = motion.v[:, None], motion.a[:, None]
        middles = (motion.s[1:] + motion.s[:-1]) / 2.0
        points = [numbers[path.line(float(s))] - 1 for s in middles]
        yield
        trajectory = PiecewisePolynomial.through(motion.t, q, d1 * v, d2 * v * v + d1 * a, points)
        factor = 1.0
        for first in range(0, len(points), _PIECES_A_STEP):
            yield
            factor = max(factor, slowdown(trajectory, limits, slice(first, first + _PIECES_A_STEP)))
        return trajectory.slower(factor * _SLOWER) if factor > 1.0 else trajectory
