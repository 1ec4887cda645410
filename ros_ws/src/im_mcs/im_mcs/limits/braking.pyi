"""Setpoints within limits, and the way to rest, compiled."""

import numpy as np
from numpy.typing import NDArray

def stopping_place(q: float, v: float, a: float, most: float, jerk: float) -> float:
    """Position of rest of one joint after the shortest jerk-limited braking [rad or m].

    First the acceleration is brought to zero, then velocity, each with jerk and acceleration at their limits. A joint
    that brakes already is taken back to where its braking began.

    Args:
        q: Position [rad or m].
        v: Velocity.
        a: Acceleration.
        most: Limit of acceleration.
        jerk: Limit of jerk.
    """

def way_to_rest(speed: float, forward: float, most: float, jerk: float) -> float:
    """Way of a joint until rest, alone.

    Args:
        speed: >= 0.
        forward: Acceleration in the direction of the motion.
        most: Limit of acceleration.
        jerk: Limit of jerk.
    """

def flags_within(
    wanted: NDArray[np.float64],
    last: NDArray[np.float64],
    dt: float,
    bounds: NDArray[np.float64],
    slopes: NDArray[np.float64],
    ends: NDArray[np.float64],
    hardest: NDArray[np.float64],
) -> NDArray[np.bool_] | None:
    """Return which setpoints are within their bounds, shape (6, n); None: all are.

    The rows are leaps of position, velocity and acceleration from the last setpoint, velocities, accelerations, and
    whether braking from the setpoint ends within the range, or no further out than the last setpoint: looked at only
    where the distance from the middle of the range, with a bound of the way to rest, is beyond its bound. A setpoint
    that is not a number is never within.

    Args:
        wanted: Positions, velocities, accelerations, shape (3, n).
        last: Those of the last tick, shape (3, n).
        dt: Time since [s].
        bounds: Of each row, shape (6, n).
        slopes: Way to rest for a velocity and for an acceleration, shape (2, n).
        ends: Ends of the range of each joint, shape (2, n) [rad or m].
        hardest: Acceleration and jerk of the hardest braking, shape (2, n).
    """

class BrakingGroup:
    """Joints braking together, in proportion.

    Args:
        velocity: Limits, shape (k,).
        acceleration: Limits, shape (k,).
        jerk: Limits, shape (k,).
        index: Ranks of the joints among all, shape (k,).
        place: The same, quicker to write to.
        across: Acceleration across the motion, as a share of its limit, that is rounding.
        reaction_s: Time in which the motion goes on before it brakes [s].

    Attributes:
        index: Ranks of the joints among all, shape (k,).
        place: The same, quicker to write to.
    """

    index: NDArray[np.intp]
    place: slice | NDArray[np.intp]
    def __init__(
        self,
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
        jerk: NDArray[np.float64],
        index: NDArray[np.intp],
        place: slice | NDArray[np.intp],
        across: float,
        reaction_s: float,
    ) -> None: ...
    def displacement(self, v: NDArray[np.float64], a: NDArray[np.float64]) -> NDArray[np.float64]:
        """Way until rest, shape (k,); not all of ``v`` and ``a``, shape (k,) each, are zero."""

    def seconds_on_path(self, v: NDArray[np.float64], a: NDArray[np.float64]) -> float:
        """Return the time along the path up to the end of a stop straight on [s]."""
