"""Setpoints of one group: motion at a multiple of the servo period, interpolated at servo rate."""

import numpy as np
from numpy.typing import NDArray

from im_core.errors import StateError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.motions.jog import JogFollower
from im_mcs.planning.motions.stream import StreamFollower
from im_mcs.planning.motions.tracked import TrackingFollower
from im_mcs.planning.trajectories.follower import Ahead, PathFollower, Standing
from im_mcs.planning.trajectories.polynomial import powers, quintic
from im_mcs.planning.trajectories.scaling import least_rate, scaled
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory

Follower = PathFollower | TrackingFollower | StreamFollower | JogFollower | Standing
"""Mover of the setpoint, from knot to knot: :meth:`advance` returns the setpoint some servo ticks ahead."""


class GroupPlanner:
    """Follower of one motion after the other; holds the position between motions.

    A motion is evaluated every ``divisor`` ticks (the paper: "typically calculated at a frequency that is a multiple of
    the servo frequency"), at *knots*, and there for the ticks up to the next one, at once. Of a stream, setpoints in
    between are the quintic through both knots, so that position, velocity and acceleration are continuous. A motion is
    followed from a knot on.

    Attributes:
        setpoint: Of this tick.
        rate: Rate wanted, 0 (stand still on the path) to 1 (as planned).
        closed: Whether only motions with an end that is known beforehand may be followed.

    Args:
        q: Where the group is, shape (n,) [rad or m]; the first setpoint.
        period_s: Servo period [s].
        divisor: Servo ticks between two evaluations, >= 1.
        limits: Limits of the group.
    """

    def __init__(self, q: NDArray[np.float64], period_s: float, divisor: int, limits: MotionLimits) -> None:
        self.period_s, self.divisor = period_s, divisor
        self.limits = limits
        self.rate, self.closed = 1.0, False
        self._bases = {ticks: _basis(ticks, period_s) for ticks in range(1, divisor + 1)}
        self.hold(q)

    def hold(self, q: NDArray[np.float64]) -> None:
        """Stand still at ``q`` from now on, in place of any motion."""
        self.setpoint = self._knot = Setpoint.at_rest(q)
        self.follower: Follower = Standing(q)
        self._ready: list[Setpoint] = []

    def follow(self, trajectory: Trajectory, start_rate: float) -> None:
        """Follow ``trajectory`` from the current knot on; required begin at ``start_rate``: the present setpoint."""
        self.follower = PathFollower(trajectory, start_rate, self.limits, self.period_s, self.divisor)

    def start_rate(self, rate: float) -> float:
        """Return the possible start rate of a trajectory for ``rate``, within limits."""
        return max(rate, least_rate(self._knot.v, self._knot.a, self.limits))

    def start_state(self, start_rate: float) -> Setpoint:
        """Return the first state of a trajectory at the current knot, in the trajectory's time."""
        if start_rate == 0.0:
            return Setpoint.at_rest(self._knot.q)
        return Setpoint(self._knot.q, self._knot.v / start_rate, self._knot.a / start_rate**2)

    @property
    def ahead(self) -> Ahead | None:
        """Displacement along a curved path within some seconds; None: the motion goes straight on."""
        place = self.follower.ahead
        return None if place is None else lambda seconds: place(seconds) - self.setpoint.q

    @property
    def at_knot(self) -> bool:
        """Whether the next setpoint is still to be computed, so another motion may take over."""
        return not self._ready

    @property
    def finished(self) -> bool:
        """Whether the motion has come to the end; true for a holding group."""
        return not self._ready and self.follower.finished

    @property
    def still(self) -> bool:
        """Whether the setpoint stands still: at the end of a motion, or halted on the way."""
        return not self._ready and self.follower.still

    @property
    def progress(self) -> float:
        """Passed fraction of the motion's time, 0 to 1."""
        return self.follower.progress

    @property
    def point(self) -> int:
        """Index of the next point of the path."""
        return self.follower.point

    @property
    def place(self) -> float:
        """Present time on the motion's own clock, for any rate [s]."""
        return self.follower.sigma

    def at(self, seconds: float) -> Setpoint:
        """Return the setpoint some time after the present one, or before it, if the rate stays [s].

        Raises:
            StateError: No trajectory is followed, or it has not begun or has ended then.
        """
        trajectory, rate = self.follower.trajectory, self.follower.rate
        if trajectory is None or self.finished:
            raise StateError("no trajectory is followed")
        place = self.place + rate * (seconds - len(self._ready) * self.period_s)
        if not 0.0 <= place < trajectory.duration:
            last = trajectory.duration
            raise StateError(f"the time is {place:.3f} s on the trajectory, which goes from 0 to {last:.3f} s")
        return scaled(trajectory.at(place), rate, 0.0)

    @property
    def plan(self) -> tuple[object, ...]:
        """Objects that stay the same as long as the motion of a closed planner goes on as planned."""
        return (self.follower, *self._planned.plan)

    @property
    def left_s(self) -> float:
        """Time until the motion of a closed planner rests, if nothing changes [s]."""
        left_s = self._planned.left_s
        return left_s + len(self._ready) * self.period_s

    def course(self, times: NDArray[np.float64]) -> Setpoint:
        """Return the setpoints, shape (m, n) each, at times from now, shape (m,) [s], if nothing changes."""
        return self._planned.course(times - len(self._ready) * self.period_s)

    def require_open(self, group: str) -> None:
        """Check whether a motion without a known end may be followed.

        Raises:
            StateError: The robot's own trajectory controller is to follow.
        """
        if self.closed:
            why = "the robot's trajectory controller cannot follow: the end of this motion is not known beforehand"
            raise StateError(f"group '{group}': {why}", group=group)

    @property
    def _planned(self) -> PathFollower | Standing:
        assert isinstance(self.follower, PathFollower | Standing), "a closed planner follows no other"
        return self.follower

    def advance(self) -> Setpoint:
        """The setpoint of the next servo tick."""
        if not self._ready:
            if self.follower.finished:
                return self.setpoint
            self._compute()
        self.setpoint = self._ready.pop()
        return self.setpoint

    def look_ahead(self) -> None:
        """Prepare the next knot during idle time, if the next setpoint is one to compute."""
        if not self._ready:
            self.follower.look_ahead()

    def _compute(self) -> None:
        before = self._knot
        knot, ticks = self.follower.advance(self.rate)
        self._knot = knot
        self._ready = [knot]
        if ticks > 1:
            ends = np.array((before.q, before.v, before.a, knot.q, knot.v, knot.a))
            exact = self.follower.between
            if exact is not None:
                self._ready += [Setpoint(*row) for row in zip(exact.q, exact.v, exact.a, strict=True)][::-1]
            elif np.count_nonzero(ends[1:3]) or np.count_nonzero(ends[4:]):
                between = self._bases[ticks].dot(ends)
                self._ready += [Setpoint(*between[k : k + 3]) for k in range(3 * ticks - 6, -1, -3)]
            elif not self.follower.still:
                self._ready *= ticks  # where a motion stands on its way, that takes its time too


def _basis(ticks: int, period_s: float) -> NDArray[np.float64]:
    """Return rows for the setpoints between two knots, shape (3 ticks - 3, 6), from both: q, v, a and q, v, a."""
    coefficients = quintic(np.array([ticks * period_s]), *np.eye(6).reshape(2, 3, 6).swapaxes(0, 1))[0]
    times = np.asarray(np.arange(1, ticks) * period_s, dtype=np.float64)
    return np.asarray(powers(times) @ coefficients).reshape(-1, 6)
