"""Time-optimal jerk-limited profiles (ruckig) as polynomials.

L. Berscheid, T. Kroeger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", RSS 2021.
Ruckig's own intermediate waypoints are not used: they need a service in the network.
"""

import math

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from im_core.errors import DataError
from im_mcs.limits.motion_limits import MotionLimits, Synchrony
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, powers
from im_mcs.planning.trajectories.trajectory import Setpoint

_RUCKIG = {Synchrony.PHASE: Synchronization.Phase, Synchrony.TIME: Synchronization.Time}
_SHORTEST_S = 1e-9
STILL = 1e-6
"""Below this speed a motion is at rest [rad/s or m/s]."""
_NOISE = {"position": 1e-9, "velocity": 1e-8, "acceleration": 1e-4}
"""What a state is off by rounding, or is as good as zero: a setpoint that drops it leaps by less than any limit."""


def request(start: Setpoint, limits: MotionLimits, synchrony: Synchrony = Synchrony.PHASE) -> InputParameter:
    """Return an input of ruckig, still without a target; ``start`` of shape (n,)."""
    asked = InputParameter(len(start.q))
    asked.synchronization = _RUCKIG[synchrony]
    asked.current_position, asked.current_velocity = start.q.tolist(), start.v.tolist()
    # a setpoint's acceleration is beyond the limit by rounding and interpolation only
    asked.current_acceleration = np.clip(start.a, -limits.acceleration, limits.acceleration).tolist()
    asked.max_velocity = limits.velocity.tolist()
    asked.max_acceleration = limits.acceleration.tolist()
    asked.max_jerk = limits.jerk.tolist()
    return asked


def to_point(
    start: Setpoint, end: NDArray[np.float64], limits: MotionLimits, synchrony: Synchrony = Synchrony.PHASE
) -> PiecewisePolynomial:
    """Return a motion from any state to rest at ``end``, shape (n,); straight from rest with common phase.

    Raises:
        DataError: Ruckig finds no trajectory.
    """
    asked = request(start, limits, synchrony)
    asked.target_position = end.tolist()
    return _solve(asked, f"from {start.q.tolist()} to {end.tolist()}")


def to_rest(start: Setpoint, limits: MotionLimits) -> PiecewisePolynomial:
    """Deceleration to rest from any state as fast as acceleration and jerk limits allow, all joints at the same time.

    Where ruckig cannot synchronise the joints, each comes to rest by itself.

    Raises:
        DataError: Ruckig finds no trajectory.
    """
    return _polynomial(_to_velocity(start, np.zeros_like(start.v), limits))


def place_of_rest(start: Setpoint, limits: MotionLimits) -> NDArray[np.float64]:
    """Return where :func:`to_rest` ends, shape (n,), in less time.

    Raises:
        DataError: Ruckig finds no trajectory.
    """
    found = _to_velocity(start, np.zeros_like(start.v), limits)
    return np.array(found.at_time(found.duration)[0])


def towards_velocity(start: Setpoint, v: NDArray[np.float64], limits: MotionLimits, seconds: float) -> Setpoint:
    """Return the state some time on the quickest way to velocities ``v``, shape (n,), which stay then.

    Raises:
        DataError: Ruckig finds no trajectory.
    """
    found = _to_velocity(start, v, limits)
    q, speed, a = (np.array(x) for x in found.at_time(min(seconds, found.duration)))
    return Setpoint(q + v * max(seconds - found.duration, 0.0), speed, a)


def _to_velocity(start: Setpoint, v: NDArray[np.float64], limits: MotionLimits) -> RuckigTrajectory:
    asked = request(start, limits)
    asked.control_interface = ControlInterface.Velocity
    asked.target_velocity = v.tolist()
    what = f"from velocity {start.v.tolist()} to {v.tolist()}"
    try:
        return _trajectory(asked, what)
    except DataError:
        asked.synchronization = Synchronization.No
        return _trajectory(asked, what)


def to_meet(
    start: Setpoint, q: NDArray[np.float64], v: NDArray[np.float64], limits: MotionLimits
) -> PiecewisePolynomial:
    """Return the quickest motion from any state to ``q`` with velocity ``v``, shape (n,).

    Raises:
        DataError: Ruckig finds no trajectory.
    """
    asked = request(start, limits)
    asked.target_position, asked.target_velocity = q.tolist(), v.tolist()
    return _solve(asked, f"to {q.tolist()} with velocity {v.tolist()}")


def with_run_out(trajectory: PiecewisePolynomial, limits: MotionLimits) -> PiecewisePolynomial:
    """Return a trajectory, with the quickest deceleration to rest behind a moving end.

    Raises:
        DataError: Ruckig finds no trajectory.
    """
    end = Setpoint(*(powers(trajectory.lengths[-1:])[0] @ trajectory.coefficients[-1]))
    if np.abs(end.v).max() <= STILL:
        return trajectory
    run_out = to_rest(end, limits)
    run_out.points = [trajectory.points[-1]] * len(run_out.points)
    return trajectory.followed_by([run_out])


def along(
    distance: float, speeds: tuple[float, float], limits: tuple[float, float, float]
) -> tuple[list[float], NDArray[np.float64]]:
    """One-dimensional profile over a distance between two speeds, with no acceleration at both ends.

    Args:
        distance: To cover, > 0.
        speeds: At its begin and end.
        limits: Of speed, acceleration and jerk.

    Returns:
        Lengths of its pieces, m of them, and coefficients of the distance covered, shape (m, 6).

    Raises:
        DataError: Ruckig finds none.
    """
    asked = InputParameter(1)
    fastest = limits[0]
    asked.current_velocity, asked.target_velocity = [min(speeds[0], fastest)], [min(speeds[1], fastest)]
    asked.target_position = [distance]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = ([limit] for limit in limits)
    profile = _solve(asked, f"over {distance} between speeds {speeds}")
    return profile.lengths.tolist(), profile.coefficients[:, :, 0]


def ramp(start: tuple[float, float, float], speed: float, acceleration: float, jerk: float) -> PiecewisePolynomial:
    """One-dimensional change of speed.

    Args:
        start: Position, speed and acceleration at the begin.
        speed: At the end, without acceleration.
        acceleration: Its limit.
        jerk: Its limit.

    Raises:
        DataError: Ruckig finds none.
    """
    asked = InputParameter(1)
    asked.control_interface = ControlInterface.Velocity
    asked.current_position, asked.current_velocity, asked.current_acceleration = ([x] for x in start)
    asked.target_velocity, asked.max_acceleration, asked.max_jerk = [speed], [acceleration], [jerk]
    return _solve(asked, f"of speed from {start[1]} to {speed}")


def transition_distance(slow: float, fast: float, acceleration: float, jerk: float) -> float:
    """Return the distance of a change between two speeds, from zero acceleration to zero."""
    change = fast - slow
    time = 2.0 * math.sqrt(change / jerk)
    if change > acceleration**2 / jerk:
        time = change / acceleration + acceleration / jerk
    return 0.5 * (slow + fast) * time


class Chase:
    """Quickest motion from any state to a target of constant velocity, and then with the target.

    The motion is planned in the frame of the target, where velocities are less by the target's, and nothing else is.

    Attributes:
        durations: Until each joint meets its target, shape (n,) [s].

    Args:
        start: State now.
        q: Target now, shape (n,).
        v: Its velocity, less than the limit, shape (n,).
        limits: Limits of velocity, acceleration and jerk.
        together: Whether all joints meet their targets at the same time.

    Raises:
        DataError: Ruckig finds no trajectory.
    """

    def __init__(
        self,
        start: Setpoint,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        limits: MotionLimits,
        *,
        together: bool,
    ) -> None:
        asked = request(Setpoint(start.q - q, start.v - v, start.a), limits)
        asked.max_velocity, asked.min_velocity = (limits.velocity - v).tolist(), (-limits.velocity - v).tolist()
        if not together:
            asked.synchronization = Synchronization.No
        asked.target_position = asked.target_velocity = [0.0] * len(q)
        found = self._trajectory = _trajectory(asked, f"to {q.tolist()} with velocity {v.tolist()}")
        self.durations = np.array([found.duration] * len(q) if together else found.independent_min_durations)
        self._duration: float = found.duration
        self._target = Setpoint(q, v, np.zeros_like(q))

    def at(self, t: float) -> Setpoint:
        """Return the state at time ``t`` [s]."""
        target = self._target
        there = target.q + target.v * t if target.v.any() else target.q
        if t >= self._duration:
            return Setpoint(there, target.v, target.a)
        q, v, a = self._trajectory.at_time(t)
        return Setpoint(there + q, target.v + v, np.array(a))


def _solve(asked: InputParameter, what: str) -> PiecewisePolynomial:
    return _polynomial(_trajectory(asked, what))


def _trajectory(asked: InputParameter, what: str) -> RuckigTrajectory:
    _round_noise(asked)
    trajectory = RuckigTrajectory(asked.degrees_of_freedom)
    try:
        result = Ruckig(asked.degrees_of_freedom).calculate(asked, trajectory)
    except RuckigError as error:
        raise DataError(f"no trajectory {what}: {error}") from None
    if result not in (Result.Working, Result.Finished):
        raise DataError(f"no trajectory {what}: ruckig reports {result.name}")
    return trajectory


def _round_noise(asked: InputParameter) -> None:
    """Set negligible values to zero.

    A joint that all but stands still, and waits for others, is else sent up to 0.25 rad away and back by ruckig.
    """
    q, target = np.array(asked.current_position), np.array(asked.target_position)
    asked.current_position = np.where(np.abs(target - q) < _NOISE["position"], target, q).tolist()
    for name in ("current_velocity", "current_acceleration", "target_velocity"):
        value = np.array(getattr(asked, name))
        setattr(asked, name, np.where(np.abs(value) < _NOISE[name.partition("_")[2]], 0.0, value).tolist())


def _polynomial(trajectory: RuckigTrajectory) -> PiecewisePolynomial:
    """Return the same motion as polynomials: jerk is constant between the changes in any joint."""
    edges = {0.0, trajectory.duration}
    for profile in trajectory.profiles[0]:
        t = 0.0
        for length in (*profile.brake.t, *profile.t):
            t += length
            edges.add(t)
    times = [0.0]
    for t in sorted(edges):
        if t - times[-1] > _SHORTEST_S and t <= trajectory.duration:
            times.append(t)
    if len(times) == 1:
        return PiecewisePolynomial.standing(np.array(trajectory.at_time(0.0)[0]))
    states = np.array([trajectory.at_time(t) for t in times])
    lengths = np.diff(times)
    coefficients = np.zeros((len(lengths), 6, states.shape[2]))
    coefficients[:, :3] = states[:-1] * np.array([1.0, 1.0, 0.5])[:, None]
    coefficients[:, 3] = np.diff(states[:, 2], axis=0) / lengths[:, None] / 6.0
    return PiecewisePolynomial(lengths.tolist(), coefficients)
