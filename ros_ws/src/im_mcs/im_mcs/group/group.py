"""One group under control: from a goal to the result, and from setpoints to torques.

Motions are prepared in slices while others move, begun at a knot, and ended one by one.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError, StateError
from im_mcs.control import ControlInput, ControlLaws
from im_mcs.group.goal_check import GoalCheck
from im_mcs.group.goal_progress import EndedGoal, GoalProgress
from im_mcs.group.goals import Current, Goal, Queued
from im_mcs.group.rates import Rates
from im_mcs.group.rest_monitor import RestMonitor, RestPhase
from im_mcs.group.streams import StreamFollowers, StreamGate
from im_mcs.model.dynamics import place_of
from im_mcs.planning.checks.admission import check_move
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.tolerances import tolerances_of
from im_mcs.planning.motions.jog import JogLimit
from im_mcs.planning.motions.stream import LAPSED, StreamFollower, StreamLease
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.requests import LineMove, MoveRequest, Policy, StreamRequest, TrajectoryMove


class ControlledGroup:
    """Motions, control law and rest monitor of the joints of one group.

    In every tick: :meth:`plan`, :meth:`advance`, :meth:`command`, :meth:`ended`. Tolerances of trajectories are judged
    within :meth:`command`.

    Attributes:
        name: Name of the group.
        planner: Setpoints that are asked for.
        setpoint: What is followed: the planner's setpoint, or what the limits have left of it.
        context: What motions are planned with.
        index: Its joints among all, shape (n,).
        place: The same, quicker to write to.
        controller: Motion control layer; a law in force of several.
        monitor: Judge of rest.
        check: Judge of goals.
        gate: Whether it takes a stream.
        engaged: Whether it has setpoints and torques.
        rates: Causes of the rate of its motions.
    """

    def __init__(
        self,
        name: str,
        planner: GroupPlanner,
        context: PlanContext,
        controller: ControlLaws,
        monitor: RestMonitor,
    ) -> None:
        self.name, self.planner, self.context = name, planner, context
        self.index, self.place = context.index, place_of(context.index)
        self.controller = controller
        self.monitor = monitor
        self.check = GoalCheck(name, context, planner, monitor)
        self.gate = StreamGate(name, planner.period_s)
        self.engaged = False
        self.setpoint = planner.setpoint
        self.rates = Rates()
        self._goals = GoalProgress(name, context, planner, self.rates, self.gate, lambda: self.still)
        self._followers = StreamFollowers(context, planner)

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Every goal: the one under way, then the waiting ones."""
        return self._goals.goals

    @property
    def paused(self) -> bool:
        """Whether the client has paused the group, or scaled the speed to 0."""
        return self.rates.halted

    @property
    def protective(self) -> ImError | None:
        """Fault of the protective stop in force, if there is one."""
        return self.rates.stopped

    @property
    def speed(self) -> float:
        """Rate in force now: 1 as planned, 0 halted."""
        return self.planner.follower.rate

    @property
    def still(self) -> bool:
        """Whether the setpoint stands still at the requested place."""
        return self.setpoint is self.planner.setpoint and self.planner.still

    @property
    def settled(self) -> bool:
        """At rest, or given up on."""
        return self.monitor.at_rest or self.monitor.timed_out

    @property
    def wants_time(self) -> bool:
        """Whether the group moves, prepares or settles, or a suspended goal's patience or a sender's lease runs."""
        return self.engaged and (self.moving or not self.settled)

    @property
    def moving(self) -> bool:
        """Whether the setpoint moves, a motion is being prepared, or a lease, a patience or a goal tolerance runs.

        The silence that is waited for of a sender counts as well.
        """
        return not self.still or self.rates.protective is not None or self.gate.closed or self._goals.open

    @property
    def _yields(self) -> bool:
        """Whether the law in force lets the arm rest off its setpoint."""
        return self.controller.name in self.context.config.switching.yielding

    # what may be asked of it

    def engage(self, q: NDArray[np.float64], before: NDArray[np.float64] | None = None) -> None:
        """Hold at ``q``, shape (n,): the first setpoint is the measured position, or the setpoint of the groups before.

        Args:
            q: Positions [rad or m].
            before: Commands of the groups before, from which the law goes on, shape (n,); None: there were none.
        """
        self.hold(q)
        self.check.q, self.check.v = q, np.zeros_like(q)
        self.check.followed = np.array([q, self.check.v])
        self.controller.reset(before)
        self.monitor.restart()
        self.engaged = True

    def hold(self, q: NDArray[np.float64]) -> None:
        """Stand still at ``q``, shape (n,), from now on."""
        self.planner.hold(q)
        self.setpoint = self.planner.setpoint

    def disengage(self) -> None:
        """End setpoint and torque; the next user begins without the pause of the former one."""
        self.engaged = self.rates.paused = False
        self.rates.override = self.rates.override or 1.0
        self.gate.open()
        self.monitor.restart()

    def switch(self, law: str, parameters: Mapping[str, Any]) -> None:
        """Let another control law take over, without a bump; the group is then to come to rest anew.

        Args:
            law: Its name; empty: the one in force.
            parameters: Of the law, in place of those of the configuration.

        Raises:
            NotFoundError: The configuration has no such law.
            ConfigError: A parameter is none of the law's, or out of range.
        """
        changed = self.controller.switch(law or self.controller.name, parameters)
        if not self.engaged:
            self.controller.reset()
        elif changed:
            self.monitor.restart()

    def request(self, goal: Goal, request: MoveRequest) -> None:
        """Take up a motion; the next ticks prepare the motion.

        Raises:
            StateError: Another motion is under way and the policy is to refuse, a protective stop holds the group, or
                the group is halted and this is a window of a stream.
            DataError: It has not as many values as the group has joints, or does not end at rest; or it is to end at a
                force, and the group has no sensor.
            LimitError: A point is out of a joint's range.
        """
        move, goals = request.path, self._goals
        self._require_free(request.policy)
        if isinstance(move, TrajectoryMove) and move.stream and self.rates.of(None) == 0.0:
            raise StateError(f"group '{self.name}' is halted; a stream is followed once it goes on", group=self.name)
        check_move(self.context, move)
        if request.until_force and not self.context.force_sensors:
            raise DataError(f"group '{self.name}' has no force sensor, and the move is to end at a force")
        tolerances = tolerances_of(self.context, move, yields=self._yields)
        self.monitor.bound(request.settle)
        queued = Queued(goal, move, request.policy, request.speed_scale, tolerances, request.until_force)
        if request.policy is Policy.REPLACE:
            replaced = goals.replaced(goal)
            queued.at_once = bool(goals.queue.motions)
            goals.queue.end(0, replaced)
            if isinstance(move, LineMove):
                # a line begins at rest: stop first
                goals.end_all(replaced)
        goals.queue.motions.append(queued)

    def stream(self, goal: Goal, request: StreamRequest) -> bool:
        """Take the newest streaming setpoint or velocity; the first one opens the goal, later ones renew the lease.

        Where a sender fell silent, the next one need not wait until the group is at rest.

        Returns:
            Whether it opened the goal.

        Raises:
            StateError: A motion along a path is under way, the group has no wrist for a twist, or the robot's own
                trajectory controller is to follow.
            NotFoundError: There is no such frame.
            DataError: It has not as many values as the group has joints.
            LimitError: The setpoint is beyond a limit.
        """
        self.planner.require_open(self.name)
        goals, current = self._goals, self._goals.current
        fault = current.goal.fault if current is not None and current.stream is not None else None
        lapsed = fault is not None and fault.code == LAPSED and not goals.queue.motions
        opened = current is not None and current.stream is not None and fault is None
        if lapsed:
            self.require_released()
        elif not opened:
            self._require_free(Policy.REFUSE)
        before = current.stream if current is not None and opened else None
        follower = self._followers.renewed(before, request)  # all refusals come before the first change
        if lapsed:
            goals.end_current(fault)
        if current is None or not opened:
            goals.current = current = Current(goal)
        if follower is not before:
            current.stream = self.planner.follower = follower
            self._begun()
        what = "setpoint" if isinstance(follower, StreamFollower) else "velocity"
        current.lease = StreamLease(request.owner, request.lease_s, self.planner.period_s, what)
        return not opened

    @property
    def jog_limit(self) -> JogLimit:
        """Reason for a slower or halted jog."""
        return self._followers.jog_limit(self.rates)

    def cancel(self, goal_id: int, fault: ImError) -> None:
        """End a goal early: a motion under way decelerates on the path, a waiting one ends at once.

        Motions that wait behind it end too: they were planned from its end.

        Raises:
            StateError: The goal is not under way.
        """
        self._goals.cancel(goal_id, fault)

    def stop(self, fault: ImError) -> None:
        """End all goals with ``fault``, decelerating on the path."""
        self._goals.end_all(fault)

    def require_released(self) -> None:
        """Check whether no protective stop holds the group.

        Raises:
            StateError: One does.
        """
        self.rates.require_released(self.name)

    def protective_stop(self, fault: ImError, *, latched: bool = False) -> None:
        """Decelerate on the path and hold; goals are suspended until :meth:`resume`, or until patience is over.

        Args:
            fault: Why.
            latched: Whether it refuses motions until :meth:`resume`, also without goals.
        """
        rates, patience_s = self.rates, self.context.config.protective.patience_s
        if latched and rates.held is None:
            rates.held = fault
        if rates.protective is None and self.goals:
            rates.protective, rates.patience = fault, round(patience_s / self.planner.period_s)

    def pause(self) -> None:
        """Halt on the path; goals go on after :meth:`resume`."""
        self.rates.paused = True

    def resume(self) -> None:
        """Go on along the path after a pause or a protective stop, and admit ended streams again."""
        self.gate.open()
        self.rates.paused = False
        self.rates.protective = self.rates.held = None

    def set_speed(self, scale: float) -> None:
        """Set the share of the planned speed, up to 1, for the current motion and later ones; 0 halts on the path."""
        self.rates.override = scale

    def drop_goals(self) -> list[Goal]:
        """Forget every goal at once; the goals."""
        return self._goals.forget_goals()

    # in every tick

    def plan(self) -> None:
        """Do one slice of the preparation of the next motion; at a knot, a ready motion begins."""
        self._goals.queue.prepare(self._goals.current)
        if self._goals.begin_next():
            self._begun()

    def advance(self) -> Setpoint:
        """The setpoint of the next servo tick."""
        self._goals.tick()
        self.setpoint = self.planner.advance()
        self._goals.note_advance()
        return self.setpoint

    def feel(self, tick: int, q: NDArray[np.float64], wrenches: NDArray[np.float64]) -> None:
        """End a guarded move at a contact; arguments as :meth:`im_mcs.planning.contact.ContactWatch.update`."""
        current = self._goals.current
        if current is None or current.contact is None or current.goal.fault is not None:
            return
        if (fault := current.contact.update(tick, q, wrenches)) is not None:
            self._goals.interrupt(fault)

    def cut(self, setpoint: Setpoint, joints: Sequence[str], tick: int) -> None:
        """Note the setpoint left by limits in the current tick: a motion along a path cannot succeed any more.

        Args:
            setpoint: What is followed.
            joints: Whose setpoints were cut; none of the group's: nothing has changed.
            tick: Number of the tick.
        """
        if not joints:
            return
        self.setpoint = setpoint
        current = self._goals.current
        if current is not None and current.stream is None and current.goal.fault is None:
            told = f"group '{self.name}': the setpoint of {', '.join(joints)} was cut to its limits at tick {tick}"
            told += "; the motion decelerates on its path and ends"
            facts = {"group": self.name, "joint": joints[0], "tick": tick}
            self._goals.interrupt(ImError(told, code="limited", **facts))

    def command(
        self,
        tick: int,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        gravity: NDArray[np.float64],
        wanted: Setpoint,
        followed: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return torques, velocities or positions of the current tick, shape (n,), for the planner's present setpoint.

        Args:
            tick: Number of the tick.
            q: Measured positions of all joints.
            v: Estimated velocities of all joints.
            gravity: Gravity torques of all joints.
            wanted: Wanted motion of all joints.
            followed: Positions and velocities that were followed when ``q`` was taken, of all joints, shape (2, m).

        Raises:
            ControlLawError: The control law failed.
        """
        position, velocity, setpoint = q[self.place].copy(), v[self.place].copy(), self.setpoint
        self.check.q, self.check.v, self.check.followed = position, velocity, followed[:, self.place]
        if self.still:
            if not self.controller.switching:
                self.monitor.update(tick, position, None if self._yields else setpoint.q)
                self.controller.hold_integral(self.monitor.phase in (RestPhase.MEASURING, RestPhase.AT_REST))
        elif self.monitor.phase is not RestPhase.MOVING:
            self._begun()
        current = self._goals.current
        if current is not None and (fault := self.check.on_the_way(current, tick)) is not None:
            self._goals.interrupt(fault)
        given = ControlInput(position, velocity, setpoint, gravity[self.place].copy(), q, wanted)
        return self.controller.command(given)

    def progress(self) -> dict[str, Any] | None:
        """Return for the goal under way the id, the passed share of time and the point; None: there is none."""
        return self._goals.under_way()

    @property
    def times(self) -> tuple[float, float]:
        """Present time on the motion asked for, and time since the begin; 0 without a goal [s]."""
        if (current := self._goals.current) is None:
            return 0.0, 0.0
        place, since = self.planner.place, current.ticks * self.planner.period_s
        return place if current.retimed is None else current.retimed.asked_time(place), since

    def ended(self) -> list[EndedGoal]:
        """Return goals ended since the last call: goal, fault, and results (``duration`` [s] of the motion)."""
        if (current := self._goals.current) is not None:
            self._judge_end(current, current.goal.fault)
        return self._goals.take_ended()

    def _require_free(self, policy: Policy) -> None:
        self.require_released()
        if policy is Policy.REFUSE and self.goals:
            told = f"group '{self.name}' is moving (goal {self.goals[0].id}); wait for its end or cancel it"
            raise StateError(told, group=self.name)

    def _judge_end(self, current: Current, fault: ImError | None) -> None:
        """End the goal under way at the end, or after an early stop."""
        if fault is not None:
            if self.still and (current.at_once or self.settled):
                self._goals.end_current(fault)
                self.hold(self.planner.setpoint.q)
        elif self.planner.finished and self.still and self.check.at_end(current):
            self._goals.end_current(self.check.fault)

    def _begun(self) -> None:
        self.monitor.restart()
        self.controller.hold_integral(False)
