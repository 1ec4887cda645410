"""Queue of motions of one group: prepared while others move, begun at a knot, ended one by one."""

from collections import deque
from typing import Any

from im_core.errors import ImError, StateError
from im_mcs.planning.arguments import LineMove, Policy
from im_mcs.planning.context import PlanContext
from im_mcs.planning.goals import Current, Goal, Queued, Rates, tolerances_of
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.preparation import prepare
from im_mcs.planning.setpoint import Setpoint

Ended = tuple[Goal, ImError | None, dict[str, Any]]


class MotionQueue:
    """Motions on a planner, one after the other.

    Attributes:
        name: Name of the group.
        planner: Setpoints.
        context: What motions are planned with.

    Args:
        name: Name of the group.
        planner: Setpoints.
        context: What motions are planned with.
    """

    def __init__(self, name: str, planner: GroupPlanner, context: PlanContext) -> None:
        self.name, self.planner, self.context = name, planner, context
        self._rates = Rates()
        self._current: Current | None = None
        self._queue: deque[Queued] = deque()
        self._ended: list[Ended] = []
        self._patience_ticks = 0

    @property
    def goal(self) -> Goal | None:
        """The goal under way, or the first that is still being prepared."""
        if self._current is not None:
            return self._current.goal
        return self._queue[0].goal if self._queue else None

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Every goal: the one under way, then those that wait."""
        first = () if self._current is None else (self._current.goal,)
        return first + tuple(queued.goal for queued in self._queue)

    @property
    def paused(self) -> bool:
        """Whether the client has paused it."""
        return self._rates.paused

    @property
    def protective(self) -> ImError | None:
        """The fault of the protective stop that holds its goals suspended, if there is one."""
        return self._rates.protective

    @property
    def speed(self) -> float:
        """Rate in force now: 1 as planned, 0 halted."""
        return self.planner.follower.rate

    def plan(self) -> None:
        """One slice of preparing the next motion; at a knot, a motion that is ready begins."""
        for rank, queued in enumerate(self._queue):
            if queued.trajectory is None:
                self._prepare(rank, queued)
                break
        self._begin_next()

    def advance(self) -> Setpoint:
        """The setpoint of the next servo tick."""
        current = self._current
        if current is not None:
            current.ticks += 1
            self._check_lease(current)
        self.planner.rate = self._rates.of(current)
        if self._rates.protective is not None:
            self._suspended(self._rates.protective)
        return self.planner.advance()

    def drop(self) -> list[Goal]:
        """Forget every goal at once; the goals."""
        goals = list(self.goals)
        self._current = None
        self._queue.clear()
        self._rates = Rates(override=self._rates.override)
        return goals

    @property
    def moving(self) -> bool:
        """Whether the setpoint moves, a motion is being prepared, or a lease, a patience or a goal tolerance runs."""
        current = self._current
        if self._rates.protective is not None:
            return True
        if any(queued.trajectory is None for queued in self._queue) and self._end_known():
            return True
        if current is not None and (current.lease is not None or (self.planner.finished and current.judges_goal)):
            return True
        if self._queue and not self._rates.paused and self._end_known():
            return True
        return not self.planner.still or (
            not self.planner.finished and self._rates.of(current) > 0.0 and not self._waits()
        )

    def _waits(self) -> bool:
        """Whether a stream stands at its target until the next one comes."""
        return self._current is not None and self._current.stream is not None and self.planner.still

    def _begun(self) -> None:
        """A motion has begun; for those who watch rest."""

    # preparation

    def _prepare(self, rank: int, queued: Queued) -> None:
        before = self._queue[rank - 1] if rank else None
        replaces = queued.policy is Policy.REPLACE and not isinstance(queued.move, LineMove)
        if replaces and not self.planner.at_knot:
            return  # it takes over in the tick in which it is ready, and that is at a knot
        if not replaces and before is None and not self._end_known():
            return
        try:
            if queued.preparation is None:
                queued.preparation = prepare(self.context, queued.move, lambda: self._start(queued))
            queued.trajectory = queued.preparation.step()
        except ImError as fault:
            self._end_queued(rank, fault)

    def _end_known(self) -> bool:
        """Whether it is known where the next motion begins: what is under way will come to the end of its path."""
        current = self._current
        return current is None or (current.goal.fault is None and current.stream is None)

    def _start(self, queued: Queued) -> Setpoint:
        """The state with which a waiting motion begins, in its own time."""
        if queued.policy is Policy.REPLACE:
            return self.planner.start_state(self._start_rate(queued))
        rank = self._queue.index(queued)
        before = self._queue[rank - 1].trajectory if rank else None
        if before is not None:
            return before.at(before.duration)
        return self.planner.follower.end

    def _start_rate(self, queued: Queued) -> float:
        return self.planner.start_rate(self._rates.of(None, queued.share))

    def _begin_next(self) -> None:
        if not self._queue or not self.planner.at_knot:
            return
        rank = next((k for k, q in enumerate(self._queue) if q.policy is Policy.REPLACE and q.trajectory), 0)
        queued = self._queue[rank]
        if queued.trajectory is None:
            return
        current = self._current
        if queued.policy is Policy.REPLACE:
            fault = self._replaced(queued.goal)
            while self._queue[0] is not queued:
                self._finish(self._queue.popleft().goal, fault, 0)
            if current is not None:
                self._end_current(current.goal.fault or fault)
        elif current is not None:
            if current.goal.fault is not None or not self.planner.finished or current.judges_goal:
                return
            self._end_current(None)
        self._queue.popleft()
        self.planner.follow(queued.trajectory, self._start_rate(queued))
        self._current = Current(queued.goal, queued.share, tolerances_of(self.context, queued.move))
        self._begun()

    # ends

    def _replaced(self, goal: Goal) -> ImError:
        return ImError(
            f"group '{self.name}': replaced by goal {goal.id}", code="replaced", group=self.name, goal=goal.id
        )

    def _require_free(self, policy: Policy) -> None:
        held = self._rates.protective
        if held is not None:
            raise StateError(
                f"group '{self.name}' is held by a protective stop ({held.message}); resume it, or wait until its "
                f"goals have ended",
                group=self.name,
            )
        goal = self.goal
        if policy is Policy.REFUSE and goal is not None:
            raise StateError(
                f"group '{self.name}' is moving (goal {goal.id}); wait for its end or cancel it", group=self.name
            )

    def _interrupt(self, fault: ImError) -> None:
        """The motion under way ends early; those behind it end at once."""
        current = self._current
        if current is not None and current.goal.fault is None:
            current.goal.fault = fault
            current.at_once = self.planner.still
        self._end_queued(0, fault)

    def _end_all(self, fault: ImError) -> None:
        self._interrupt(fault)
        self._rates.protective = None

    def _end_queued(self, rank: int, fault: ImError) -> None:
        """End the waiting motion of a rank, and those behind it."""
        ended = [self._queue.pop() for _ in range(len(self._queue) - rank)]
        for queued in reversed(ended):
            self._finish(queued.goal, fault, 0)

    def _end_current(self, fault: ImError | None) -> None:
        assert self._current is not None
        self._finish(self._current.goal, fault, self._current.ticks)
        self._current = None
        if self.goal is None:
            self._rates.protective = None

    def _finish(self, goal: Goal, fault: ImError | None, ticks: int) -> None:
        self._ended.append((goal, fault, {"duration": ticks * self.planner.period_s}))

    def _suspended(self, fault: ImError) -> None:
        self._patience_ticks -= 1
        if self._patience_ticks < 0:
            self._end_all(fault)

    def _check_lease(self, current: Current) -> None:
        if current.lease is not None and current.goal.fault is None:
            current.lease.tick()
            fault = current.lease.lapsed()
            if fault is not None:
                self._interrupt(fault)
                current.at_once = False
