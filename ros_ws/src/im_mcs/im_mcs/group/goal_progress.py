"""Progress of a group's goals: the goal under way, waiting goals, and the ends of all."""

from collections.abc import Callable
from typing import Any

from im_core.errors import ImError, StateError
from im_mcs.group.goals import Current, Goal
from im_mcs.group.motion_queue import MotionQueue
from im_mcs.group.rates import Rates
from im_mcs.group.streams import StreamGate
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.motions.stream import StreamLease
from im_mcs.planning.planner import GroupPlanner
from im_mcs.protocol.requests import Policy

EndedGoal = tuple[Goal, ImError | None, dict[str, Any]]
"""A goal, why it ended badly if it did, and results: ``duration`` [s] of its motion, ``retimed`` if it took longer."""


class GoalProgress:
    """Goals of one group.

    Attributes:
        current: The motion under way.
        queue: Motions that wait.

    Args:
        name: Of the group.
        context: What motions are planned with.
        planner: Setpoints of the group.
        rates: Rates of its motions.
        gate: Gate of its streams.
        still: Whether the setpoint stands.
    """

    def __init__(
        self,
        name: str,
        context: PlanContext,
        planner: GroupPlanner,
        rates: Rates,
        gate: StreamGate,
        still: Callable[[], bool],
    ) -> None:
        self.current: Current | None = None
        self.queue = MotionQueue(name, context, planner, rates, lambda goal, fault: self._finish(goal, fault, 0))
        self._name, self._planner, self._rates, self._gate, self._still = name, planner, rates, gate, still
        self._ended: list[EndedGoal] = []

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Every goal: the one under way, then the waiting ones."""
        first = () if self.current is None else (self.current.goal,)
        return first + self.queue.goals

    @property
    def open(self) -> bool:
        """Whether something is still to come without a request: a motion, the end of a lease or of a tolerance."""
        current, planner = self.current, self._planner
        if self.queue.has_work(current):
            return True
        if current is None:
            return not planner.finished and self._rates.of(None) > 0.0
        if current.lease is not None or (planner.finished and current.tolerances is not None):
            return True
        waits = current.stream is not None and planner.still
        return not planner.finished and self._rates.of(current) > 0.0 and not waits

    def under_way(self) -> dict[str, Any] | None:
        """Return for the goal under way the id, the passed share of time and the point; None: there is none."""
        if self.current is None:
            return None
        return {"id": self.current.goal.id, "progress": self._planner.progress, "point": self._planner.point}

    def begin_next(self) -> bool:
        """Begin the next motion if ready; return whether a motion begins."""
        queued, current = self.queue.next_motion(self.current), self.current
        if queued is not None:
            if current is not None:
                replaces = queued.policy is Policy.REPLACE
                self.end_current((current.goal.fault or self.replaced(queued.goal)) if replaces else None)
            self.current = self.queue.begin()
        for waiting in self.queue.motions:
            waiting.ticks += 1
        return queued is not None

    def tick(self) -> None:
        """Count a tick of the goal under way and of the patience with suspended goals."""
        self._gate.tick()
        if (current := self.current) is not None:
            current.ticks += 1
            if current.lease is not None:
                self._check_lease(current, current.lease)
        self._planner.rate = self._rates.of(current)
        if (protective := self._rates.protective) is not None:
            self._rates.patience -= 1
            if self._rates.patience < 0:
                self.end_all(protective)
                self.close_gate(protective)

    def note_advance(self) -> None:
        """Note a setpoint's advance: time passed on the trajectory asked for, and the fault of a stream."""
        if (current := self.current) is not None:
            planner = self._planner
            current.passed_s += planner.period_s * (1.0 if planner.finished else planner.follower.rate)
            if current.stream is not None and current.stream.fault is not None:
                self.interrupt(current.stream.fault)

    def cancel(self, goal_id: int, fault: ImError) -> None:
        """End a goal early, and the motions waiting behind.

        Raises:
            StateError: The goal is not under way.
        """
        if self.current is not None and self.current.goal.id == goal_id:
            self.interrupt(fault)
            self.close_gate(fault)
            return
        for rank, goal in enumerate(self.queue.goals):
            if goal.id == goal_id:
                self.queue.end(rank, fault)
                return
        raise StateError(f"goal {goal_id} is not under way", goal=goal_id)

    def interrupt(self, fault: ImError) -> None:
        """End the motion under way early; the motions queued behind end at once."""
        current = self.current
        if current is not None and current.goal.fault is None:
            current.goal.fault = fault
            current.at_once = self._still()
        self.queue.end(0, fault)

    def end_all(self, fault: ImError) -> None:
        """End all goals and the suspending protective stop."""
        self.interrupt(fault)
        self._rates.protective = None

    def end_current(self, fault: ImError | None) -> None:
        """End the goal under way now."""
        assert self.current is not None
        self._finish(self.current.goal, fault, self.current.ticks)
        self.current = None
        if not self.goals:
            self._rates.protective = None

    def close_gate(self, fault: ImError) -> None:
        """Close the gate of a stopped stream: the next setpoint must not restart the stream."""
        if self.current is not None and (lease := self.current.lease) is not None:
            self._gate.close(lease.owner, lease.seconds, fault)

    def forget_goals(self) -> list[Goal]:
        """Forget every goal at once; the goals."""
        goals = list(self.goals)
        self.current = None
        self.queue.motions.clear()
        self._rates.forget_goals()
        return goals

    def take_ended(self) -> list[EndedGoal]:
        """Return goals ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def replaced(self, goal: Goal) -> ImError:
        """Return the fault of goals replaced by another."""
        told = f"group '{self._name}': replaced by goal {goal.id}"
        return ImError(told, code="replaced", group=self._name, goal=goal.id)

    def _finish(self, goal: Goal, fault: ImError | None, ticks: int) -> None:
        results: dict[str, Any] = {"duration": ticks * self._planner.period_s}
        current = self.current
        if current is not None and current.goal is goal:
            if current.retimed is not None:
                results["retimed"] = current.retimed.report
            if current.contact is not None:
                fault = current.contact.verdict(fault)
                results["force"] = current.contact.force
        self._ended.append((goal, fault, results))

    def _check_lease(self, current: Current, lease: StreamLease) -> None:
        if current.goal.fault is None:
            lease.tick()
            if (fault := lease.lapsed()) is not None:
                self.interrupt(fault)
                current.at_once = False
