"""Goals of motions: the one under way, and the waiting ones."""

from dataclasses import dataclass

from im_core.errors import ImError
from im_mcs.planning.checks.tolerances import TrajectoryTolerances
from im_mcs.planning.contact import ContactWatch
from im_mcs.planning.motions.preparation import Preparation
from im_mcs.planning.motions.stream import OpenFollower, StreamLease
from im_mcs.planning.retiming import RetimedTrajectory
from im_mcs.planning.trajectories.trajectory import Trajectory
from im_mcs.protocol.requests import SLOWEST, Move, Policy


@dataclass
class Goal:
    """Motion with a waiting client.

    Attributes:
        id: Request that asked for it.
        since_tick: Tick at which it was asked for, and
        since_ns: its testbed time [ns].
        fault: Why it ends early, if it does.
    """

    id: int
    since_tick: int
    since_ns: int
    fault: ImError | None = None


@dataclass
class Queued:
    """Waiting motion: in preparation, or ready.

    Attributes:
        goal: Who waits for it.
        move: What is asked for.
        policy: What becomes of motions before it.
        share: Speed scale of this motion alone.
        tolerances: Of a trajectory.
        until_force: Change of the force at a wrist that ends it [N]; 0: none.
        at_once: It has taken the place of another that had not begun: a trajectory waits for no re-timing.
        ticks: Since it was asked for.
        preparation: Its preparation, once begun.
        trajectory: Once prepared.
    """

    goal: Goal
    move: Move
    policy: Policy
    share: float
    tolerances: TrajectoryTolerances | None
    until_force: float = 0.0
    at_once: bool = False
    ticks: int = 0
    preparation: Preparation | None = None
    trajectory: Trajectory | None = None


@dataclass
class Current:
    """The motion under way.

    Attributes:
        goal: Who waits for it.
        share: Speed scale of this motion alone.
        tolerances: Of a trajectory.
        retimed: The trajectory, if it is not followed in the time asked for.
        asked: The trajectory as it came, if it is not what is followed, and
        asked_s: its duration [s].
        passed_s: Time that has passed on it, at the rate in force [s].
        stream: Its follower, and
        lease: the lease of the sender, of streaming setpoints or velocities.
        ticks: Since it began.
        at_once: It ends early, and stood still already.
        contact: Judge of the contact that ends a guarded move.
    """

    goal: Goal
    share: float = 1.0
    tolerances: TrajectoryTolerances | None = None
    retimed: RetimedTrajectory | None = None
    asked: Trajectory | None = None
    asked_s: float = 0.0
    passed_s: float = 0.0
    stream: OpenFollower | None = None
    lease: StreamLease | None = None
    ticks: int = 0
    at_once: bool = False
    contact: ContactWatch | None = None


@dataclass
class Rates:
    """Causes of the rate of motions.

    Attributes:
        override: Of the client, above 0 up to 1; 0 halts.
        ceiling: Of the collision monitor, above 0 up to 1.
        scaling: Of the robot itself, 0 to 1, on top of the others; 0 halts.
        paused: By the client.
        protective: Fault of a protective stop in force.
    """

    override: float = 1.0
    ceiling: float = 1.0
    scaling: float = 1.0
    paused: bool = False
    protective: ImError | None = None

    def of(self, current: Current | None, share: float | None = None) -> float:
        """Rate wanted of a motion."""
        halted = self.paused or 0.0 in (self.override, self.scaling) or self.protective is not None
        if halted or (current is not None and current.goal.fault is not None):
            return 0.0
        if share is None:
            share = 1.0 if current is None else current.share
        return min(max(self.override * share, SLOWEST), self.ceiling) * self.scaling
