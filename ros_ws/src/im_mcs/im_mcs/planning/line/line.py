"""Straight lines of the wrist in SE(3) (paper, section 4), prepared in bounded slices."""

from collections.abc import Generator
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import DataError, StateError
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.context import PlanContext, Start
from im_mcs.planning.checks.envelope import excess
from im_mcs.planning.line.carriers import CarrierChoice
from im_mcs.planning.line.curve import JointCurves, LineCurve
from im_mcs.planning.line.geometry import CarriedPath, LinePath, parameter_length
from im_mcs.planning.line.speed import Profile, fit
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic
from im_mcs.protocol.requests import LineMove

# Quintics in time between knots this far apart follow curve and profile to far less than a micrometre [s or m].
_KNOT_S, _KNOT_M = 0.02, 2e-3
# Longest motion between two rests [s].
_LONGEST_S = 1e4
_SAME_M = 1e-9
# A corner that can only be rounded less than this is rested in: that is quicker, and third derivatives are sound.
_TIGHTEST_M = 1e-3
_PIECES_A_STEP = 100
# rounding must not bring a limit back that a slower motion just keeps
_SLOWER = 1.0 + 1e-9


class _LineArm:
    """One arm on a line, with its joints in the group: shape (n,); a group of one arm has all its joints there."""

    def __init__(self, context: PlanContext, frame: str, start: NDArray[np.float64]) -> None:
        self.frame, self.arm = frame, Arm(context.model, frame)
        self.arm.give_up(start)
        missing = [context.model.names[i] for i in self.arm.joints if i not in context.index]
        if missing:
            raise StateError(f"a straight line of {frame} needs {', '.join(missing)}, not in the group")
        below = context.model.joints_below(frame)
        self.index = context.index if len(context.frames) == 1 else context.index[np.isin(context.index, below)]
        self.tracker = ArmTracker(context.model, self.arm, frame)
        lever = context.config.planning.line.rotation_lever_m
        self.choice = CarrierChoice(context.model, context.limits, self.index, self.arm, self.tracker, frame, lever)


class LinePreparation:
    """Maker of the motion of a wrist along straight lines through poses, or of two that keep their relative pose.

    Joints are found by inverse kinematics along the line, at places as close as it takes to keep the line, and joined
    by quintics. A one-dimensional profile of the path parameter sets the speed, with one bound of velocity,
    acceleration and jerk for all lines between two rests, and one speed for each rounded corner: the largest with
    which no joint passes its limits. That is time-optimal only where the arm's Jacobian changes little on the way.
    It rests in corners that the lines are too short to round by a millimetre.

    An arm of five joints keeps the position, and the orientation but for turns about one axis of the wrist: the one
    about which it cannot turn the wrist in its place where the line begins.

    A group that carries its arm on joints of its own (a cart) moves these too where that helps, see
    :class:`~im_mcs.planning.line.carriers.CarrierChoice`.

    Args:
        context: What to plan with.
        move: Poses of the wrist in ``world``, its speed, and how corners are rounded.
        start: Gives the state it begins with, at rest.

    Raises:
        StateError: The group has no wrist, or not all joints of its arm.
    """

    def __init__(self, context: PlanContext, move: LineMove, start: Start) -> None:
        if not context.frames:
            raise StateError("the group has no wrist; a straight line needs one")
        self._context = context
        self._settings = context.config.planning.line
        self._start = context.q_all().copy()
        self._start[context.index] = start().q
        self._arms = [_LineArm(context, frame, self._start) for frame in context.frames]
        self._tracker = self._arms[0].tracker
        self._poses = [pin.XYZQUATToSE3(np.array(values)) for values in move.poses]
        self._speed, self._blend = move.speed or np.inf, move.blend
        self._work = self._prepare()

    def step(self) -> PiecewisePolynomial | None:
        """Do one slice: one place of a line, or one round of the speed.

        Raises:
            DataError: It is so slow that it would take too long.
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
            corners = [self._tracker.pose(q), *(self._poses[number - 1] for number in numbers)]
            curves, begin = [], q
            for arm in self._arms:
                relative = self._relative(arm)
                carriers, there = [q[arm.arm.carriers]], q
                for pose in corners[1:]:
                    there = yield from arm.choice.choose(there, pose if relative is None else pose * relative)
                    carriers.append(there[arm.arm.carriers])
                settings = corners, np.array(carriers), self._blend, self._settings.rotation_lever_m
                path = LinePath(*settings) if relative is None else CarriedPath(*settings, relative)
                curve, q = yield from self._line_curve(arm, path, numbers).walk(q)
                curves.append((np.flatnonzero(np.isin(self._context.index, arm.index)), curve))
            self._require_end(path)
            whole = JointCurves(begin[self._context.index], curves)
            profile = yield from fit(whole, path.size, limits, self._fastest(path), path.rounded)
            parts.append((yield from self._timed(path, whole, profile, numbers, limits)))
        if not parts:
            return PiecewisePolynomial.standing(q[self._context.index])
        return parts[0].followed_by(parts[1:])

    def _runs(self) -> list[list[int]]:
        """Return numbers of the poses passed without rest in between.

        Of poses within half the blend and a tight corner of each other one is passed; the last is reached.
        """
        poses = [self._tracker.pose(self._start), *self._poses]

        def length(a: int, b: int) -> float:
            return parameter_length(poses[a], poses[b], self._settings.rotation_lever_m)

        same, last = max(_SAME_M, min(self._blend / 2.0, _TIGHTEST_M)), len(self._poses)
        passed = [0]
        for number in range(1, last):
            if length(passed[-1], number) > same:
                passed.append(number)
        while passed[-1] > 0 and length(passed[-1], last) <= same:
            passed.pop()
        if length(passed[-1], last) > _SAME_M:
            passed.append(last)
        runs, before = list[list[int]](), 0.0
        for start, end in pairwise(passed):
            after = length(start, end)
            if min(self._blend, before / 2.0, after / 2.0) < _TIGHTEST_M:
                runs.append([])
            runs[-1].append(end)
            before = after
        return runs

    def _relative(self, arm: "_LineArm") -> pin.SE3 | None:
        """Pose in the first wrist at the begin, which is kept; None of the first itself."""
        if arm is self._arms[0]:
            return None
        return self._tracker.pose(self._start).actInv(arm.tracker.pose(self._start))

    def _line_curve(self, arm: "_LineArm", path: LinePath, numbers: list[int]) -> LineCurve:
        return LineCurve(
            arm.tracker,
            arm.arm,
            self._context.limits,
            arm.index,
            path,
            arm.frame,
            self._settings.singular_value,
            self._settings.deviation_m,
            self._settings.rotation_lever_m,
            numbers,
        )

    def _fastest(self, path: LinePath) -> float:
        """Return the velocity of the path parameter for the wanted speed of the wrist on the fastest line [m/s]."""
        share = max(way / (b - a) for way, (a, b) in zip(path.lengths, pairwise(path.corners), strict=True))
        return self._speed / share if share > 0.0 else np.inf

    def _require_end(self, path: LinePath) -> None:
        """Refuse a motion slow enough to seem endless."""
        shortest_s = path.size / self._fastest(path)
        if shortest_s > _LONGEST_S:
            raise DataError(
                f"a line of {path.size:.4g} m at {self._speed:.4g} m/s takes {shortest_s:.4g} s; up to "
                f"{_LONGEST_S:g} s may lie between two rests",
                value=shortest_s,
                limit=_LONGEST_S,
                unit="s",
            )

    def _timed(
        self, path: LinePath, curve: JointCurves, profile: Profile, numbers: list[int], limits: MotionLimits
    ) -> Generator[None, None, PiecewisePolynomial]:
        """Return the motion between two rests, slowed down as a whole for excesses of the quintics between knots."""
        motion = profile.sampled(_KNOT_S, path.edges[1:-1], _KNOT_M)
        yield
        lengths, parts, factor = np.diff(motion.t), list[NDArray[np.float64]](), 1.0
        for first in range(0, len(lengths), _PIECES_A_STEP):
            pieces, knots = slice(first, first + _PIECES_A_STEP), slice(first, first + _PIECES_A_STEP + 1)
            q, d1, d2, _ = curve.at(np.minimum(motion.s[knots], path.size))
            v, a = motion.v[knots, None], motion.a[knots, None]
            parts.append(quintic(lengths[pieces], q, d1 * v, d2 * v * v + d1 * a))
            factor = max(factor, float(excess(parts[-1], lengths[pieces], limits).max()))
            yield
        if factor > 1.0:
            factor *= _SLOWER
        scale = (1.0 / factor) ** np.arange(6)[:, None]
        for part in parts:
            part *= scale
            yield
        points = np.array(numbers)[path.lines((motion.s[1:] + motion.s[:-1]) / 2.0)] - 1
        return PiecewisePolynomial(lengths * factor, np.concatenate(parts), points.tolist())
