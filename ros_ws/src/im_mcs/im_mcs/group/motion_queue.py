"""Waiting motions: prepared in slices while others move, and begun at a knot, one after the other."""

from collections import deque
from collections.abc import Callable

from im_core.errors import ImError
from im_mcs.group.goals import Current, Goal, Queued
from im_mcs.group.rates import Rates
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.contact import ContactWatch
from im_mcs.planning.motions.preparation import prepare
from im_mcs.planning.motions.tracked import TrackedTrajectory, TrackingFollower
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.retiming import RetimedTrajectory
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.requests import LineMove, Policy, TrajectoryMove


class MotionQueue:
    """Waiting motions of one group.

    Attributes:
        motions: The motions, the next one first.

    Args:
        name: Of the group.
        context: What motions are planned with.
        planner: Setpoints of the group.
        rates: Rates of its motions.
        finish: Ends a goal that waits no more.
    """

    def __init__(
        self,
        name: str,
        context: PlanContext,
        planner: GroupPlanner,
        rates: Rates,
        finish: Callable[[Goal, ImError], None],
    ) -> None:
        self.motions: deque[Queued] = deque()
        self._name, self._context, self._planner = name, context, planner
        self._rates, self._finish = rates, finish

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Goals of the motions."""
        return tuple(queued.goal for queued in self.motions)

    def has_work(self, current: Current | None) -> bool:
        """Return whether a motion is being prepared, or begins without a further request."""
        waits = bool(self.motions) and self._end_known(current)
        return waits and (not self._rates.halted or any(queued.trajectory is None for queued in self.motions))

    def prepare(self, current: Current | None) -> None:
        """Do one slice of the preparation of the next motion without a trajectory."""
        for rank, queued in enumerate(self.motions):
            if queued.trajectory is None:
                self._prepare(rank, queued, current)
                break

    def next_motion(self, current: Current | None) -> Queued | None:
        """Return the motion to begin now, at a knot; a motion under way then ends."""
        queued, planner = self.motions[0] if self.motions else None, self._planner
        if queued is None or queued.trajectory is None or not planner.at_knot:
            return None
        ended = current is None or (current.goal.fault is None and planner.finished and current.tolerances is None)
        return queued if ended or queued.policy is Policy.REPLACE else None

    def begin(self) -> Current:
        """Let the planner follow the first motion, no longer waiting; return the motion under way."""
        queued, planner = self.motions.popleft(), self._planner
        trajectory, rate = queued.trajectory, self._start_rate(queued)
        assert trajectory is not None
        if isinstance(trajectory, TrackedTrajectory):
            planner.follower = TrackingFollower(
                planner.setpoint, trajectory, rate, planner.limits, planner.period_s, planner.divisor
            )
        else:
            planner.follow(trajectory, rate)
        current = Current(queued.goal, queued.share, queued.tolerances, asked_s=trajectory.duration)
        if queued.until_force:
            context = self._context
            current.contact = ContactWatch(self._name, context.force_sensors, context.model, queued.until_force)
        self._note_asked(current, queued, trajectory)
        return current

    def end(self, rank: int, fault: ImError) -> None:
        """End the motion of a rank, and all motions behind."""
        ended = [self.motions.pop() for _ in range(len(self.motions) - rank)]
        for queued in reversed(ended):
            self._finish(queued.goal, fault)

    def _prepare(self, rank: int, queued: Queued, current: Current | None) -> None:
        planner = self._planner
        replaces = queued.policy is Policy.REPLACE and not isinstance(queued.move, LineMove)
        if replaces and not planner.at_knot:
            return  # it takes over in the tick in which it is ready, and that is at a knot
        if replaces and not planner.still and self._rates.of(None) == 0.0:
            return  # what is to halt halts first: to take over would be to move on
        if not replaces and not rank and not self._end_known(current):
            return
        try:
            if queued.preparation is None:
                queued.preparation = prepare(
                    self._context,
                    queued.move,
                    lambda: self._start(queued),
                    lambda: self._passed_s(queued),
                    at_once=queued.at_once and not planner.closed,
                )
            queued.trajectory = queued.preparation.step()
            if isinstance(queued.trajectory, TrackedTrajectory):
                planner.require_open(self._name)
        except ImError as fault:
            self.end(rank, fault)
        except Exception as error:  # one motion that cannot be planned must not take the power of all groups
            unplanned = f"group '{self._name}': the motion cannot be planned: {error!r}"
            self.end(rank, ImError(unplanned, code="internal", group=self._name))

    def _end_known(self, current: Current | None) -> bool:
        """Return whether the begin of the next motion is known: the present one will reach the end of the path."""
        follower = self._planner.follower
        if isinstance(follower, TrackingFollower) and not follower.end_known:
            return False
        return current is None or (current.goal.fault is None and current.stream is None)

    def _start(self, queued: Queued) -> Setpoint:
        """Return the first state of a waiting motion, in the motion's time."""
        if queued.policy is Policy.REPLACE:
            return self._planner.start_state(self._start_rate(queued))
        rank = self.motions.index(queued)
        before = self.motions[rank - 1].trajectory if rank else None
        return self._planner.follower.end_setpoint if before is None else before.at(before.duration)

    def _passed_s(self, queued: Queued) -> float:
        """Return the time on the clock of a waiting trajectory at the present setpoint, of the last tick [s]."""
        move, period_s = queued.move, self._planner.period_s
        if isinstance(move, TrajectoryMove) and move.start_ns:
            return 1e-9 * (queued.goal.since_ns - move.start_ns) + (queued.ticks - 1) * period_s
        return queued.ticks * period_s

    def _start_rate(self, queued: Queued) -> float:
        return self._planner.start_rate(self._rates.of(None, queued.share))

    def _note_asked(self, current: Current, queued: Queued, trajectory: Trajectory) -> None:
        """Note the trajectory asked for and the time since the earliest begin, for tolerances of the client."""
        if isinstance(trajectory, TrackedTrajectory):
            current.asked, current.passed_s = trajectory, trajectory.begin_s
        elif isinstance(trajectory, RetimedTrajectory):
            current.retimed, current.asked = trajectory, trajectory.asked
            current.asked_s = trajectory.asked.duration
            if queued.policy is not Policy.APPEND:
                current.passed_s = (queued.ticks + 1) * self._planner.period_s
