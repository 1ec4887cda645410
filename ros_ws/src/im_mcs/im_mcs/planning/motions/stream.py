"""Streaming setpoints: the newest target is chased, jerk-limited, and a silent sender is noticed."""

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.profile import Chase, to_rest
from im_mcs.planning.trajectories.trajectory import Setpoint

_FOLLOWED = 0.98
"""Share of the velocity limit with which a target is followed at most: what is left makes up for a lag."""


LAPSED = "lease"
"""Code of the fault of a lease that has lapsed."""


class StreamLease:
    """Time until which a sender must be heard of again, in testbed time from receipt.

    Attributes:
        owner: Who sends.
        seconds: How long silence may last [s].

    Args:
        owner: As the attribute.
        seconds: As the attribute.
        tick_s: Servo period [s].
        what: What is sent, for the message.
    """

    def __init__(self, owner: str, seconds: float, tick_s: float, what: str = "setpoint") -> None:
        self.owner, self.seconds, self._tick_s, self._what = owner, seconds, tick_s, what
        self._silent = 0

    def tick(self) -> None:
        """One more tick of silence."""
        self._silent += 1

    def lapsed(self) -> ImError | None:
        """Return the fault of a sender silent for too long."""
        if self._silent * self._tick_s <= self.seconds:
            return None
        who = f"'{self.owner}'" if self.owner else "the sender"
        return ImError(
            f"{who} has sent no {self._what} for {self.seconds:g} s, its lease",
            code=LAPSED,
            owner=self.owner,
            lease_s=self.seconds,
        )


class OpenFollower:
    """Common part of followers without a known end: a sender renews the goal.

    Attributes:
        rate: Rate in force.
        fault: Why it follows no more, but comes to rest.

    Args:
        start: Present setpoint.
        limits: Of the group.
        tick_s: Servo period [s].
        divisor: Servo ticks between two evaluations.
    """

    finished = False
    progress, point, sigma = 0.0, 0, 0.0
    ahead = between = trajectory = None

    def __init__(self, start: Setpoint, limits: MotionLimits, tick_s: float, divisor: int) -> None:
        self._state, self._limits = start, limits
        self._divisor, self._knot_s = divisor, tick_s * divisor
        self.rate = 1.0
        self.fault: ImError | None = None

    @property
    def end_setpoint(self) -> Setpoint:
        """Present setpoint."""
        return self._state


class StreamFollower(OpenFollower):
    """Chase the newest target, replanned at every knot in motion; a target with a velocity keeps moving.

    Args:
        start: Present setpoint.
        limits: Of the group.
        lower: Least positions, shape (n,) [rad or m].
        upper: Largest positions, shape (n,).
        tick_s: Servo period [s].
        divisor: Servo ticks between two evaluations.
    """

    def __init__(
        self,
        start: Setpoint,
        limits: MotionLimits,
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        tick_s: float,
        divisor: int,
    ) -> None:
        super().__init__(start, limits, tick_s, divisor)
        self._lower, self._upper = lower, upper
        self._target, self._drift, self._age = start.q, np.zeros_like(start.q), 0.0
        self._chase: Chase | None = None
        self._halt: PiecewisePolynomial | None = None
        self._elapsed = 0.0
        self._held = np.zeros(len(start.q), dtype=np.bool_)

    def renew(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Set a new target: position and velocity, shape (n,) each."""
        self._target, self._drift, self._age = q, v, 0.0
        self._chase = None

    @property
    def still(self) -> bool:
        """Whether the setpoint stands at the target, or is halted."""
        return not self._state.v.any() and not self._state.a.any() and (self.rate == 0.0 or self._arrived())

    def advance(self, rate: float) -> tuple[Setpoint, int]:
        """The setpoint at the next knot; ``rate`` scales the velocity limits, 0 halts."""
        self._age += self._knot_s
        if rate != self.rate:
            self.rate = rate
            self._chase = self._halt = None
        if rate == 0.0:
            self._state = self._halted()
        elif not (self._arrived() and not self._state.v.any() and not self._state.a.any()):
            try:
                self._state = self._chased(rate)
            except DataError as fault:
                self.fault = fault
                self._state = self._halted()
        return self._state, self._divisor

    def look_ahead(self) -> None:
        """Prepare nothing: the next target is the sender's."""

    def _arrived(self) -> bool:
        return not self._drift.any() and np.array_equal(self._state.q, self._target)

    def _halted(self) -> Setpoint:
        if self._halt is None:
            self._halt, self._elapsed = to_rest(self._state, self._limits), 0.0
        self._elapsed += self._knot_s
        return self._halt.at(self._elapsed)

    def _chased(self, rate: float) -> Setpoint:
        if self._chase is None or (self._outside(self._age) & ~self._held).any():
            limits = MotionLimits(self._limits.velocity * rate, self._limits.acceleration, self._limits.jerk)
            self._chase, self._elapsed = self._intercept(limits, rate), 0.0
        self._elapsed += self._knot_s
        return self._chase.at(self._elapsed)

    def _intercept(self, limits: MotionLimits, rate: float) -> Chase:
        """Return the motion to the moving target; joints without room for a stop behind the meeting go to its place."""
        age = self._age - self._knot_s
        now = np.clip(self._target + self._drift * age, self._lower, self._upper)
        follow = np.clip(self._drift * rate, -_FOLLOWED * limits.velocity, _FOLLOWED * limits.velocity)
        self._held = self._outside(self._age)
        chase = self._met(now, np.where(self._held, 0.0, follow), limits)
        if (beyond := ~self._held & self._outside(age + chase.durations)).any():
            self._held |= beyond
            chase = self._met(now, np.where(self._held, 0.0, follow), limits)
        return chase

    def _met(self, now: NDArray[np.float64], drift: NDArray[np.float64], limits: MotionLimits) -> Chase:
        try:
            return Chase(self._state, now, drift, limits, together=True)
        except DataError:  # ruckig cannot always synchronise joints, least of all while they are slowed down
            return Chase(self._state, now, drift, limits, together=False)

    def _outside(self, age: float | NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return joints with a target beyond any stop within the range at an age [s]."""
        speed, limits = np.abs(self._drift), self._limits
        way = speed * (speed / limits.acceleration + limits.acceleration / limits.jerk) / 2.0
        stop = self._target + self._drift * age + np.sign(self._drift) * way
        return np.asarray((stop < self._lower) | (stop > self._upper))
