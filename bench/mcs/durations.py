"""How long moves take, over time-optimal jerk-limited durations that are computed here, on their own."""

import math

import numpy as np
from numpy.typing import NDArray

from bench.figures import Line
from bench.mcs.rig import Rig, rig
from im_mcs.limits.configuration import McsConfig

_MOVES = 100
_REACH = 0.35


def rest_to_rest_s(distance: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Shortest time of a motion from rest to rest: the double S profile [s].

    L. Biagiotti, C. Melchiorri, "Trajectory Planning for Automatic Machines and Robots" (2008), 3.4.

    Args:
        distance: To go, >= 0.
        velocity: Largest.
        acceleration: Largest.
        jerk: Largest.
    """
    if distance == 0.0:
        return 0.0
    ramp = acceleration / jerk
    reached = velocity * jerk >= acceleration**2  # the largest acceleration
    rise = ramp + velocity / acceleration if reached else 2.0 * math.sqrt(velocity / jerk)
    if distance >= velocity * rise:
        return rise + distance / velocity
    if distance >= 2.0 * acceleration * ramp**2:
        peak = (-(acceleration * ramp) + math.sqrt((acceleration * ramp) ** 2 + 4.0 * acceleration * distance)) / 2.0
        return 2.0 * (ramp + peak / acceleration)
    return 4.0 * math.cbrt(distance / (2.0 * jerk))


def straight_s(
    way: NDArray[np.float64], limits: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
) -> float:
    """Shortest time of a move straight in joint space: the limits on the path parameter are the tightest joint's.

    Args:
        way: What each joint goes, shape (n,) [rad or m].
        limits: Velocities, accelerations, jerks, shape (n,) each.
    """
    moving = np.abs(way) > 0.0
    along = [float((limit[moving] / np.abs(way[moving])).min()) for limit in limits]
    return rest_to_rest_s(1.0, *along)


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Durations of a hundred random moves of nine joints over the time-optimal ones, settling left out."""
    random = np.random.default_rng(seed)
    ratios = []
    with rig(config.with_preset("2x9"), seed) as machine:
        machine.to_motion("left")
        home = machine.setpoint[0, :9].copy()
        motion = machine.mcs.limits.motion
        limits = (motion.velocity[:9], motion.acceleration[:9], motion.jerk[:9])
        present = home
        for _ in range(_MOVES):
            target = home + random.uniform(-_REACH, _REACH, 9)
            ratios.append(_moving_s(machine, target) / straight_s(target - present, limits))
            present = target
    name = f"{_MOVES} joint moves: duration"
    return [
        Line(f"{name}, mean", float(np.mean(ratios)), "", 1.0, "time-optimal", bar=1.01),
        Line(f"{name}, max", float(np.max(ratios)), "", 1.0, "time-optimal"),
    ]


def _moving_s(machine: Rig, target: NDArray[np.float64]) -> float:
    """Time for which the setpoint moves on its way to a target, shape (9,) [s]."""
    moving = 0

    def watch() -> None:
        nonlocal moving
        moving += bool(machine.setpoint[1].any())

    machine.move("left", target, on_tick=watch)
    return (moving + 1) * machine.mcs.config.servo.period_s
