"""Straight lines and arcs of the wrist in SE(3) (paper, section 4), and motions of two, prepared in bounded slices."""

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, StateError
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.context import PlanContext, Start
from im_mcs.planning.checks.envelope import excess
from im_mcs.planning.line.carriers import CarrierChoice
from im_mcs.planning.line.curve import JointCurve, JointCurves, LineCurve
from im_mcs.planning.line.geometry import WristPath
from im_mcs.planning.line.route import Route, Stop
from im_mcs.planning.line.speed import Profile, fit
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic
from im_mcs.protocol.requests import LineMove

# Quintics in time between knots this far apart follow curve and profile to far less than a micrometre [s or m].
_KNOT_S, _KNOT_M = 0.02, 2e-3
# Longest motion between two rests [s].
_LONGEST_S = 1e4
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
        self.index = context.index if len(context.frames) == 1 else context.below(frame)
        self.tracker = ArmTracker(context.model, self.arm, frame)
        lever = context.config.planning.line.rotation_lever_m
        self.choice = CarrierChoice(context.model, context.limits, self.index, self.arm, self.tracker, frame, lever)


class LinePreparation:
    """Maker of the motion of a wrist along straight lines and arcs through poses, and of a second wrist beside it.

    The second wrist keeps its pose in the first, or goes through poses in it while the first moves or stands still. The
    first may move straight from point to point in joint space instead.

    Joints are found by inverse kinematics along the line, at places as close as it takes to keep the line, and joined
    by quintics. A one-dimensional profile of the path parameter sets the speed, with one bound of velocity,
    acceleration and jerk for all lines between two rests, and one speed for each rounded corner: the largest with
    which no joint passes its limits. That is time-optimal only where the arm's Jacobian changes little on the way.
    It rests in corners that the lines are too short to round by a millimetre.

    An arm of fewer than six joints keeps the position, and the orientation but for turns about those axes of the wrist
    about which it cannot turn the wrist in its place where the line begins.

    A group that carries its arm on joints of its own (a cart) moves these too where that helps, see
    :class:`~im_mcs.planning.line.carriers.CarrierChoice`.

    Args:
        context: What to plan with.
        move: Poses of the wrist in ``world``, its speed, and how corners are rounded.
        start: Gives the state it begins with, at rest.

    Raises:
        StateError: The group has no wrist, or not all joints of its arm.
        DataError: Three places of an arc are on a straight line.
    """

    def __init__(self, context: PlanContext, move: LineMove, start: Start) -> None:
        if not context.frames:
            raise StateError("the group has no wrist; a straight line needs one")
        self._context = context
        self._settings = context.config.planning.line
        self._lever = self._settings.rotation_lever_m
        self._start = context.q_all().copy()
        self._start[context.index] = start().q
        self._arms = [_LineArm(context, frame, self._start) for frame in context.frames]
        self._tracker = self._arms[0].tracker
        trackers = [arm.tracker for arm in self._arms]
        self._route = Route(move, self._start, context.lead, trackers, context.model.cell, self._lever)
        self._speed = move.speed or np.inf
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
        for run in self._route.runs():
            stops = [self._route.stops[number] for number in run]
            stops[0] = replace(stops[0], pose=self._tracker.pose(q))  # an arm of few joints may be turned there
            numbers = [self._route.number(end) for end in run[1:]]
            curves, begin, path = [], q, None
            for arm in self._arms:
                path, curve, q = yield from self._arm_moved(arm, stops, numbers, q)
                curves.append((np.flatnonzero(np.isin(self._context.index, arm.index)), curve))
            assert path is not None, "a group with a wrist has an arm"
            self._require_end(path)
            whole = JointCurves(begin[self._context.index], curves)
            profile = yield from fit(whole, path.size, limits, self._fastest(path), path.rounded)
            parts.append((yield from self._timed(path, whole, profile, numbers, limits)))
        if not parts:
            return PiecewisePolynomial.standing(q[self._context.index])
        return parts[0].followed_by(parts[1:])

    def _arm_moved(
        self, arm: "_LineArm", stops: list[Stop], numbers: list[int], q: NDArray[np.float64]
    ) -> Generator[None, None, tuple[WristPath, JointCurve, NDArray[np.float64]]]:
        """Return the path of the wrist of an arm, the curve of its joints, and all joints at the end."""
        is_second, own, there = arm is not self._arms[0], arm.arm.carriers, q
        if not is_second and stops[0].q is not None:
            straight = self._route.joint_path(stops, np.zeros((len(stops), 0)))
            s = np.array(straight.edges)
            places = np.array([straight.joints(each) for each in s])[:, :, arm.index]
            curve = JointCurve(s, quintic(np.diff(s), *(places[:, k] for k in range(3))))
            end = q.copy()
            end[self._context.lead] = straight.joints(straight.size)[0, self._context.lead]
            return straight, curve, end
        carriers = [q[own]]
        for stop in stops[1:]:
            pose = stop.pose * stop.relative if is_second else stop.pose
            there = yield from arm.choice.choose(there, pose, None if is_second else stop.via)
            carriers.append(there[own])
        path = self._route.path(stops, np.array(carriers), second=is_second)
        curve, there = yield from self._line_curve(arm, path, numbers).walk(q)
        return path, curve, there

    def _line_curve(self, arm: "_LineArm", path: WristPath, numbers: list[int]) -> LineCurve:
        return LineCurve(
            arm.tracker,
            arm.arm,
            self._context.limits,
            arm.index,
            path,
            arm.frame,
            self._settings.singular_value,
            self._settings.deviation_m,
            self._lever,
            numbers,
        )

    def _fastest(self, path: WristPath) -> float:
        """Return the velocity of the path parameter for the wanted speed of the wrist on the fastest line [m/s]."""
        share = max(way / size for way, size in zip(path.lengths, path.sizes, strict=True))
        return self._speed / share if share > 0.0 else np.inf

    def _require_end(self, path: WristPath) -> None:
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
        self, path: WristPath, curve: JointCurves, profile: Profile, numbers: list[int], limits: MotionLimits
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
        points = np.array(numbers)[path.legs((motion.s[1:] + motion.s[:-1]) / 2.0)] - 1
        return PiecewisePolynomial(lengths * factor, np.concatenate(parts), points.tolist())
