"""Goals of motions: the one under way, and the waiting ones."""

from dataclasses import dataclass

from im_core.errors import ImError
from im_mcs.planning.checks.tolerances import TrajectoryTolerances
from im_mcs.planning.contact import ContactWatch
from im_mcs.planning.motions.preparation import Preparation
from im_mcs.planning.motions.stream import OpenFollower, StreamLease
from im_mcs.planning.retiming import RetimedTrajectory
from im_mcs.planning.trajectories.trajectory import Trajectory
from im_mcs.protocol.requests import Move, Policy


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
