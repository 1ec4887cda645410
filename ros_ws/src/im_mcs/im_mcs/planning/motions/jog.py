"""Jog: the newest wanted velocity of joints or wrist is followed as far as limits and singularities allow.

At every knot the setpoint makes for the wanted velocity. The next state is taken only if a stop from there ends within
the ranges of all joints; else the stop that the state before allowed is carried out.
"""

from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, StateError
from im_mcs.inverse.arm import Arm
from im_mcs.inverse.tracking import ArmTracker
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.motions.stream import OpenFollower
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.profile import place_of_rest, to_rest, towards_velocity
from im_mcs.planning.trajectories.trajectory import Setpoint

# share of acceleration and jerk that slows down before the end of a joint's range, or more than that brakes
_GENTLE = 0.5
# a smaller share of the wanted velocity is none
_LEAST = 1e-3
# slow down from this multiple of the singular value at which lines end
_NEAR = 3.0
# how far ahead the singular value is compared [s]
_LOOK_S = 0.02


class JogLimit(IntEnum):
    """What slows a jog down, or halts it; the numbers that ``moveit_msgs/ServoStatus`` has are the same."""

    NONE = 0
    SINGULARITY_AHEAD = 1
    SINGULARITY = 2
    COLLISION_AHEAD = 4
    COLLISION = 5
    JOINT_RANGE = 6
    VELOCITY = 7
    HELD = 8


@dataclass(frozen=True)
class Jog:
    """Wanted velocity of the joints of a group, or of the wrist.

    Attributes:
        velocity: Of the joints, shape (n,) [rad/s or m/s]; or of the wrist, shape (6,): linear [m/s], angular [rad/s].
        frame: Frame along whose axes the wrist moves, wherever the frame is by then; empty: of the joints.
    """

    velocity: NDArray[np.float64]
    frame: str = ""


class JogFollower(OpenFollower):
    """Follower of the newest wanted velocity.

    Attributes:
        limit: What slows down or halts the jog now.

    Args:
        start: Present setpoint.
        context: Of the group.
        tracker: Kinematics of its wrist, as :func:`wrist_tracker` makes them.
        tick_s: Servo period [s].
        divisor: Servo ticks between two evaluations.
    """

    def __init__(
        self, start: Setpoint, context: PlanContext, tracker: ArmTracker | None, tick_s: float, divisor: int
    ) -> None:
        super().__init__(start, context.limits.motion.of(context.index), tick_s, divisor)
        self._context, self._tracker = context, tracker
        self._jog = Jog(np.zeros_like(start.q))
        self._wanted = np.zeros_like(start.q)
        self._stop: PiecewisePolynomial | None = None
        self._end, self._passed = place_of_rest(start, self._limits), 0.0
        self.limit = JogLimit.NONE

    def renew(self, jog: Jog) -> None:
        """Set the wanted velocity.

        Raises:
            StateError: The group has no wrist, or not all joints of its arm.
            NotFoundError: There is no such frame.
        """
        if jog.frame:
            self._context.model.frame_id(jog.frame)
            if self._tracker is None:
                raise StateError("a twist needs a group with a wrist and all joints of its arm")
        self._jog = jog

    @property
    def still(self) -> bool:
        """Whether the setpoint stands, and is to stand."""
        return not self._state.v.any() and not self._state.a.any() and not self._wanted.any()

    def advance(self, rate: float) -> tuple[Setpoint, int]:
        """The setpoint at the next knot; ``rate`` scales the wanted velocity, 0 halts."""
        self.rate = rate
        self._wanted = np.zeros_like(self._wanted)
        after = None
        if rate > 0.0:
            try:
                after = self._next(rate)
            except DataError as fault:
                self.fault = fault
        if after is None:
            if self._stop is None:
                self._stop, self._passed = to_rest(self._state, self._limits), 0.0
            self._passed += self._knot_s
            after = self._stop.at(self._passed)
        self._state = after
        return after, self._divisor

    def look_ahead(self) -> None:
        """Prepare nothing: the next velocity is the sender's."""

    def _next(self, rate: float) -> Setpoint | None:
        """Return the state at the next knot, with a stop behind it; None where that would end out of a range."""
        self._wanted = self._allowed(rate)
        if not self._wanted.any() and not self._state.v.any() and not self._state.a.any():
            return self._state
        after = towards_velocity(self._state, self._wanted, self._limits, self._knot_s)
        end = place_of_rest(after, self._limits)
        lower, upper = self._ranges
        if (end < np.minimum(lower, self._end)).any() or (end > np.maximum(upper, self._end)).any():
            self.limit = JogLimit.JOINT_RANGE
            self._wanted = np.zeros_like(self._wanted)
            return None
        self._stop, self._end = None, end
        return after

    @property
    def _ranges(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        limits, index = self._context.limits, self._context.index
        return limits.lower[index], limits.upper[index]

    def _allowed(self, rate: float) -> NDArray[np.float64]:
        """Return the wanted joint velocities as limits and singularities allow, all joints slowed down alike."""
        self.limit = JogLimit.NONE
        tracker = self._tracker if self._jog.frame else None
        v = self._jog.velocity if tracker is None else self._of_joints(self._jog, tracker)
        fastest = float((np.abs(v) / self._limits.velocity).max())
        if fastest > 1.0:
            self.limit, v = JogLimit.VELOCITY, v / fastest
        if tracker is not None and v.any():
            v = v * self._share_near_singularity(v, tracker)
        share = self._share_of_range(v)
        if share < 1.0:
            self.limit = JogLimit.JOINT_RANGE
        return v * rate * share

    def _of_joints(self, jog: Jog, tracker: ArmTracker) -> NDArray[np.float64]:
        """Return the velocities of the arm's joints that move the wrist; the joints that carry the arm stand."""
        q = self._all(self._state.q)
        turn = self._context.model.pose(q, jog.frame).rotation
        twist = np.concatenate([turn @ jog.velocity[:3], turn @ jog.velocity[3:]])
        v = tracker.velocities(q, twist)
        if v is None:
            self.limit = JogLimit.SINGULARITY
            return np.zeros_like(self._state.q)
        return v[self._context.index]

    def _share_near_singularity(self, v: NDArray[np.float64], tracker: ArmTracker) -> float:
        """Return the share of the velocities ``v`` that is left on the way into a singularity; 1 on the way out."""
        least, q = self._context.config.planning.line.singular_value, self._state.q
        left = tracker.singular_value(self._all(self._end)) - least
        share = float(np.clip(left / (least * (_NEAR - 1.0)), 0.0, 1.0))
        if share == 1.0 or tracker.singular_value(self._all(q + _LOOK_S * v)) >= tracker.singular_value(self._all(q)):
            return 1.0
        self.limit = JogLimit.SINGULARITY if share < _LEAST else JogLimit.SINGULARITY_AHEAD
        return share if share >= _LEAST else 0.0

    def _share_of_range(self, v: NDArray[np.float64]) -> float:
        """Return the share of the velocities ``v`` from which gentle braking ends within the ranges of all joints."""
        lower, upper = self._ranges
        room = np.maximum(np.where(v > 0.0, upper - self._state.q, self._state.q - lower), 0.0)
        force, ramp = _GENTLE * self._limits.acceleration, self._limits.acceleration / self._limits.jerk
        fastest = force * (np.sqrt(ramp**2 + 8.0 * room / force) - ramp) / 2.0
        over = np.abs(v) > fastest
        share = float((fastest[over] / np.abs(v)[over]).min(initial=1.0))
        return share if share >= _LEAST else 0.0

    def _all(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = self._context.q_all().copy()
        whole[self._context.index] = q
        return whole


def wrist_tracker(context: PlanContext) -> ArmTracker | None:
    """Return the kinematics of a group's wrist for jogs; None where the group has none, or not all joints of its arm.

    That takes longer than a tick has.
    """
    for frame in context.frames if len(context.frames) == 1 else ():
        with suppress(StateError):  # of a wrist that hangs on two joints or one
            arm = Arm(context.model, frame)
            if np.isin(arm.joints, context.index).all():
                return ArmTracker(context.model, arm, frame)
    return None
