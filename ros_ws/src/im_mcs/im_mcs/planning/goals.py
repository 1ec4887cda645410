"""Motions that somebody waits for: the one under way, and those that wait behind it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.planning.arguments import Move, Policy
from im_mcs.planning.context import PlanContext, Preparation
from im_mcs.planning.stream import Lease, StreamFollower
from im_mcs.planning.tolerance import Tolerances
from im_mcs.planning.trajectory import Trajectory
from im_mcs.planning.trajectory_arguments import TrajectoryMove


@dataclass
class Goal:
    """A motion that somebody waits for.

    Attributes:
        id: Request that asked for it.
        since_tick: Tick at which it was asked for.
        fault: Why it ends early, if it does.
    """

    id: int
    since_tick: int
    fault: ImError | None = None


@dataclass
class Queued:
    """A motion that waits: being prepared, or ready.

    Attributes:
        goal: Who waits for it.
        move: What is asked for.
        policy: What becomes of motions before it.
        share: Speed scale of this motion alone.
        preparation: Its preparation, once begun.
        trajectory: Once prepared.
    """

    goal: Goal
    move: Move
    policy: Policy
    share: float
    preparation: Preparation | None = None
    trajectory: Trajectory | None = None


@dataclass
class Current:
    """The motion under way.

    Attributes:
        goal: Who waits for it.
        share: Speed scale of this motion alone.
        tolerances: Of a trajectory.
        stream: Its follower, and
        lease: the lease of the sender, of streaming setpoints.
        ticks: Since it began.
        late_ticks: Since it has come to its end.
        at_once: It ends early, and stood still already.
    """

    goal: Goal
    share: float = 1.0
    tolerances: Tolerances | None = None
    stream: StreamFollower | None = None
    lease: Lease | None = None
    ticks: int = 0
    late_ticks: int = 0
    at_once: bool = False

    @property
    def judges_goal(self) -> bool:
        """Whether tolerances decide over its end, and not rest alone."""
        return self.tolerances is not None and self.tolerances.judges_goal


@dataclass
class Rates:
    """What sets the rate of motions.

    Attributes:
        override: Of the client, above 0 up to 1.
        ceiling: Of the collision monitor, 0 to 1.
        paused: By the client.
        protective: Fault of a protective stop in force.
    """

    override: float = 1.0
    ceiling: float = 1.0
    paused: bool = False
    protective: ImError | None = None

    def of(self, current: Current | None, share: float | None = None) -> float:
        """Rate wanted of a motion."""
        if self.paused or self.protective is not None or (current is not None and current.goal.fault is not None):
            return 0.0
        if share is None:
            share = 1.0 if current is None else current.share
        return min(self.override * share, self.ceiling)


def tolerances_of(context: PlanContext, move: Move) -> Tolerances | None:
    """Tolerances of a motion, if it is a trajectory; 0 is the bound of the following error, below 0 none."""
    if not isinstance(move, TrajectoryMove):
        return None
    limits, index = context.limits, context.index
    path = _bounds(move.path_tolerance, move.path_velocity_tolerance, limits.following_error[index])
    goal = _bounds(move.goal_tolerance, move.goal_velocity_tolerance, np.inf)
    names, units = [limits.names[i] for i in index], [limits.units[i] for i in index]
    return Tolerances(names, units, path, goal, move.goal_time_s)


def _bounds(
    q: NDArray[np.float64], v: NDArray[np.float64], default: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Bounds of positions and velocities, shape (2, n); there is no default for velocities."""
    bounds = np.array([np.where(q == 0.0, default, q), np.where(v == 0.0, np.inf, v)])
    return np.where(bounds < 0.0, np.inf, bounds)
