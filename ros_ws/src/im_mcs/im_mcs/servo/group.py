"""One group under control: from a goal to the result, and from setpoints to torques.

Motions are prepared in slices while others move, begun at a knot, and ended one by one.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError, StateError
from im_mcs.control import ControlInput, ControlLaws
from im_mcs.model.dynamics import place_of
from im_mcs.planning.checks.admission import check_jog, check_move, check_stream
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.tolerances import tolerances_of
from im_mcs.planning.contact import ContactWatch
from im_mcs.planning.goals import Current, Goal, Queued, Rates
from im_mcs.planning.motions.jog import Jog, JogFollower, JogLimit, wrist_tracker
from im_mcs.planning.motions.preparation import prepare
from im_mcs.planning.motions.stream import LAPSED, OpenFollower, StreamFollower, StreamLease
from im_mcs.planning.motions.tracked import TrackedTrajectory, TrackingFollower
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.retiming import RetimedTrajectory
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.requests import LineMove, MoveRequest, Policy, StreamRequest, TrajectoryMove
from im_mcs.servo.goal_check import GoalCheck
from im_mcs.servo.rest_monitor import RestMonitor, RestPhase
from im_mcs.servo.stream_gate import StreamGate

EndedGoal = tuple[Goal, ImError | None, dict[str, Any]]
"""A goal, why it ended badly if it did, and results: ``duration`` [s] of its motion, ``retimed`` if it took longer."""

_CEILING_STEPS = 20
_SCALING_STEP = 0.01


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
        held: Fault of a protective stop that was asked for: latched until the group is resumed.
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
        self.held: ImError | None = None
        self.setpoint = planner.setpoint
        self._rates = Rates()
        self._current: Current | None = None
        self._queue: deque[Queued] = deque()
        self._ended: list[EndedGoal] = []
        self._patience_ticks = 0
        self._tracker = wrist_tracker(context)

    @property
    def goal(self) -> Goal | None:
        """The goal under way, or the first in preparation."""
        if self._current is not None:
            return self._current.goal
        return self._queue[0].goal if self._queue else None

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Every goal: the one under way, then the waiting ones."""
        first = () if self._current is None else (self._current.goal,)
        return first + tuple(queued.goal for queued in self._queue)

    @property
    def paused(self) -> bool:
        """Whether the client has paused the group, or scaled its speed to 0."""
        return self._rates.paused or self._rates.override == 0.0

    @property
    def protective(self) -> ImError | None:
        """Fault of the protective stop that holds the group, if there is one."""
        return self._rates.protective or self.held

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
        if not self.still or self._rates.protective is not None or self.gate.closed:
            return True
        waits = self._queue and self._end_known()
        if waits and (not self.paused or any(queued.trajectory is None for queued in self._queue)):
            return True
        current = self._current
        if current is not None and (
            current.lease is not None or (self.planner.finished and current.tolerances is not None)
        ):
            return True
        return not self.planner.finished and self._rates.of(current) > 0.0 and not self._waits()

    @property
    def _yields(self) -> bool:
        """Whether the law in force lets the arm rest off its setpoint."""
        return self.controller.name in self.context.config.switching.yielding

    # what may be asked of it

    def engage(self, q: NDArray[np.float64], before: NDArray[np.float64] | None = None) -> None:
        """Hold at ``q``, shape (n,): the first setpoint is the measured position, or that of the groups before.

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
        self.engaged = self._rates.paused = False
        self._rates.override = self._rates.override or 1.0
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
        move = request.path
        self._require_free(request.policy)
        if isinstance(move, TrajectoryMove) and move.stream and self._rates.of(None) == 0.0:
            raise StateError(f"group '{self.name}' is halted; a stream is followed once it goes on", group=self.name)
        check_move(self.context, move)
        if request.until_force and not self.context.force_sensors:
            raise DataError(f"group '{self.name}' has no force sensor, and the move is to end at a force")
        tolerances = tolerances_of(self.context, move, yields=self._yields)
        self.monitor.bound(request.settle)
        queued = Queued(goal, move, request.policy, request.speed_scale, tolerances, request.until_force)
        if request.policy is Policy.REPLACE:
            replaced = self._replaced(goal)
            queued.at_once = bool(self._queue)
            self._end_queued(0, replaced)
            if isinstance(move, LineMove):
                # a line begins at rest: stop first
                self._end_all(replaced)
        self._queue.append(queued)

    def stream(self, goal: Goal, request: StreamRequest) -> bool:
        """Take the newest streaming setpoint or velocity; the first one opens the goal, later ones renew the lease.

        Where a sender fell silent, the next one need not wait until the group is at rest.

        Returns:
            Whether it opened the goal.

        Raises:
            StateError: A motion along a path is under way, or the group has no wrist for a twist.
            NotFoundError: There is no such frame.
            DataError: It has not as many values as the group has joints.
            LimitError: The setpoint is beyond a limit.
        """
        current = self._current
        fault = current.goal.fault if current is not None and current.stream is not None else None
        lapsed = fault is not None and fault.code == LAPSED and not self._queue
        opened = current is not None and current.stream is not None and fault is None
        if lapsed:
            self.require_released()
        elif not opened:
            self._require_free(Policy.REFUSE)
        before = current.stream if current is not None and opened else None
        follower = self._renewed(before, request)  # all refusals come before the first change
        if lapsed:
            self._end_current(fault)
        if current is None or not opened:
            self._current = current = Current(goal)
        if follower is not before:
            current.stream = self.planner.follower = follower
            self._begun()
        what = "setpoint" if isinstance(follower, StreamFollower) else "velocity"
        current.lease = StreamLease(request.owner, request.lease_s, self.planner.period_s, what)
        return not opened

    def _renewed(self, before: OpenFollower | None, request: StreamRequest) -> StreamFollower | JogFollower:
        """Return the follower of a stream before, or of another kind a new one, with the newest target."""
        context, planner = self.context, self.planner
        if request.kind == "setpoint":
            target = check_stream(context, request)
            if not isinstance(before, StreamFollower):
                limits, index = context.limits, context.index
                lower, upper = limits.lower[index], limits.upper[index]
                start = planner.start_state(1.0)
                before = StreamFollower(start, planner.limits, lower, upper, planner.period_s, planner.divisor)
            before.renew(*target)
            return before
        jog = Jog(check_jog(context, request), request.frame if request.kind == "twist" else "")
        if not isinstance(before, JogFollower):
            start = planner.start_state(1.0)
            before = JogFollower(start, context, self._tracker, planner.period_s, planner.divisor)
        before.renew(jog)
        return before

    @property
    def jog_limit(self) -> JogLimit:
        """What slows the jog under way down, or halts it."""
        follower, protective = self.planner.follower, self.protective
        if not isinstance(follower, JogFollower):
            return JogLimit.NONE
        if protective is not None:
            return JogLimit.COLLISION if protective.code == "collision" else JogLimit.HELD
        if self.paused:
            return JogLimit.HELD
        return follower.limit or (JogLimit.COLLISION_AHEAD if self._rates.ceiling < 1.0 else JogLimit.NONE)

    def cancel(self, goal_id: int, fault: ImError) -> None:
        """End a goal early: a motion under way decelerates on the path, a waiting one ends at once.

        Motions that wait behind it end too: they were planned from its end.

        Raises:
            StateError: The goal is not under way.
        """
        if self._current is not None and self._current.goal.id == goal_id:
            self._interrupt(fault)
            self._close_gate(fault)
            return
        for rank, queued in enumerate(self._queue):
            if queued.goal.id == goal_id:
                self._end_queued(rank, fault)
                return
        raise StateError(f"goal {goal_id} is not under way", goal=goal_id)

    def stop(self, fault: ImError) -> None:
        """End all goals with ``fault``, decelerating on the path."""
        self._end_all(fault)

    def require_released(self) -> None:
        """Check whether no protective stop holds the group.

        Raises:
            StateError: One does.
        """
        if self.protective is not None:
            end = "" if self.held is not None else ", or wait until its goals have ended"
            raise StateError(
                f"group '{self.name}' is held by a protective stop ({self.protective.message}); resume it{end}",
                group=self.name,
            )

    def protective_stop(self, fault: ImError, *, latched: bool = False) -> None:
        """Decelerate on the path and hold; goals are suspended until :meth:`resume`, or until patience is over.

        Args:
            fault: Why.
            latched: Whether it refuses motions until :meth:`resume`, also without goals.
        """
        if latched and self.held is None:
            self.held = fault
        if self._rates.protective is None and self.goal is not None:
            self._rates.protective = fault
            self._patience_ticks = round(self.context.config.protective.patience_s / self.planner.period_s)

    def pause(self) -> None:
        """Halt on the path; goals go on after :meth:`resume`."""
        self._rates.paused = True

    def resume(self) -> None:
        """Go on along the path after a pause or a protective stop, and admit ended streams again."""
        self.gate.open()
        self._rates.paused = False
        self._rates.protective = self.held = None

    def set_speed(self, scale: float) -> None:
        """Set the share of the planned speed, up to 1, for the current motion and later ones; 0 halts on the path."""
        self._rates.override = scale

    def inherit(self, former: Sequence["ControlledGroup"]) -> None:
        """Take over a pause and the smallest speed of the groups before."""
        rates = [group._rates for group in former]
        self._rates.override = min(rate.override for rate in rates)
        self._rates.paused = any(rate.paused for rate in rates)

    def set_ceiling(self, scale: float) -> None:
        """Set the upper bound of the rate, in steps of 0.05 from 0.05 to 1; independent of the client's override."""
        self._rates.ceiling = max(int(scale * _CEILING_STEPS), 1) / _CEILING_STEPS

    def set_scaling(self, scale: float) -> None:
        """Set the share of the wanted speed with which the robot follows, 0 to 1; small changes are none."""
        if scale in (0.0, 1.0) or abs(scale - self._rates.scaling) > _SCALING_STEP:
            self._rates.scaling = scale

    def drop_goals(self) -> list[Goal]:
        """Forget every goal at once; the goals."""
        goals = list(self.goals)
        self._current = None
        self._queue.clear()
        self._rates = Rates(override=self._rates.override, scaling=self._rates.scaling)
        return goals

    # in every tick

    def plan(self) -> None:
        """Do one slice of the preparation of the next motion; at a knot, a ready motion begins."""
        for rank, queued in enumerate(self._queue):
            if queued.trajectory is None:
                self._prepare(rank, queued)
                break
        self._begin_next()
        for queued in self._queue:
            queued.ticks += 1

    def advance(self) -> Setpoint:
        """The setpoint of the next servo tick."""
        self.gate.tick()
        current = self._current
        if current is not None:
            current.ticks += 1
            if current.lease is not None:
                self._check_lease(current, current.lease)
        self.planner.rate = self._rates.of(current)
        if self._rates.protective is not None:
            self._suspended(self._rates.protective)
        self.setpoint = self.planner.advance()
        if current is not None:
            current.passed_s += self.planner.period_s * (1.0 if self.planner.finished else self.speed)
        if current is not None and current.stream is not None and current.stream.fault is not None:
            self._interrupt(current.stream.fault)
        return self.setpoint

    def feel(self, tick: int, q: NDArray[np.float64], wrenches: NDArray[np.float64]) -> None:
        """End a guarded move at a contact; arguments as :meth:`im_mcs.planning.contact.ContactWatch.update`."""
        current = self._current
        if current is None or current.contact is None or current.goal.fault is not None:
            return
        if (fault := current.contact.update(tick, q, wrenches)) is not None:
            self._interrupt(fault)

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
        current = self._current
        if current is not None and current.stream is None and current.goal.fault is None:
            self._interrupt(
                ImError(
                    f"group '{self.name}': the setpoint of {', '.join(joints)} was cut to its limits at tick {tick}; "
                    "the motion decelerates on its path and ends",
                    code="limited",
                    group=self.name,
                    joint=joints[0],
                    tick=tick,
                )
            )

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
        if self._current is not None and (fault := self.check.on_the_way(self._current, tick)) is not None:
            self._interrupt(fault)
        return self.controller.command(
            ControlInput(position, velocity, setpoint, gravity[self.place].copy(), q, wanted)
        )

    def progress(self) -> dict[str, Any] | None:
        """Return for the goal under way the id, the passed share of time and the point; None: there is none."""
        current = self._current
        if current is None:
            return None
        return {"id": current.goal.id, "progress": self.planner.progress, "point": self.planner.point}

    @property
    def times(self) -> tuple[float, float]:
        """Time at which the motion asked for is where this one is, and time since it began; 0 without a goal [s]."""
        current, place = self._current, self.planner.place
        if current is None:
            return 0.0, 0.0
        since = current.ticks * self.planner.period_s
        return place if current.retimed is None else current.retimed.asked_time(place), since

    def ended(self) -> list[EndedGoal]:
        """Return goals ended since the last call: goal, fault, and results (``duration`` [s] of the motion)."""
        current = self._current
        if current is not None:
            self._judge_end(current.goal.fault)
        ended, self._ended = self._ended, []
        return ended

    # preparation

    def _prepare(self, rank: int, queued: Queued) -> None:
        before = self._queue[rank - 1] if rank else None
        replaces = queued.policy is Policy.REPLACE and not isinstance(queued.move, LineMove)
        if replaces and not self.planner.at_knot:
            return  # it takes over in the tick in which it is ready, and that is at a knot
        if replaces and not self.planner.still and self._rates.of(None) == 0.0:
            return  # what is to halt halts first: to take over would be to move on
        if not replaces and before is None and not self._end_known():
            return
        try:
            if queued.preparation is None:
                queued.preparation = prepare(
                    self.context,
                    queued.move,
                    lambda: self._start(queued),
                    lambda: self._passed_s(queued),
                    at_once=queued.at_once,
                )
            queued.trajectory = queued.preparation.step()
        except ImError as fault:
            self._end_queued(rank, fault)
        except Exception as error:  # one motion that cannot be planned must not take the power of all groups
            unplanned = f"group '{self.name}': the motion cannot be planned: {error!r}"
            self._end_queued(rank, ImError(unplanned, code="internal", group=self.name))

    def _end_known(self) -> bool:
        """Return whether the begin of the next motion is known: the present one will reach the end of the path."""
        current, follower = self._current, self.planner.follower
        if isinstance(follower, TrackingFollower) and not follower.end_known:
            return False
        return current is None or (current.goal.fault is None and current.stream is None)

    def _start(self, queued: Queued) -> Setpoint:
        """Return the first state of a waiting motion, in the motion's time."""
        if queued.policy is Policy.REPLACE:
            return self.planner.start_state(self._start_rate(queued))
        rank = self._queue.index(queued)
        before = self._queue[rank - 1].trajectory if rank else None
        if before is not None:
            return before.at(before.duration)
        return self.planner.follower.end_setpoint

    def _passed_s(self, queued: Queued) -> float:
        """Return the time on the clock of a waiting trajectory at the present setpoint, that of the last tick [s]."""
        move, period_s = queued.move, self.planner.period_s
        if isinstance(move, TrajectoryMove) and move.start_ns:
            return 1e-9 * (queued.goal.since_ns - move.start_ns) + (queued.ticks - 1) * period_s
        return queued.ticks * period_s

    def _start_rate(self, queued: Queued) -> float:
        return self.planner.start_rate(self._rates.of(None, queued.share))

    def _begin_next(self) -> None:
        if not self._queue or not self.planner.at_knot:
            return
        queued, current, planner = self._queue[0], self._current, self.planner
        trajectory = queued.trajectory
        if trajectory is None:
            return
        if current is not None:
            if queued.policy is Policy.REPLACE:
                self._end_current(current.goal.fault or self._replaced(queued.goal))
            elif current.goal.fault is None and planner.finished and current.tolerances is None:
                self._end_current(None)
            else:
                return
        self._queue.popleft()
        if isinstance(trajectory, TrackedTrajectory):
            rate = self._start_rate(queued)
            follower = TrackingFollower(
                planner.setpoint, trajectory, rate, planner.limits, planner.period_s, planner.divisor
            )
            planner.follower = follower
        else:
            planner.follow(trajectory, self._start_rate(queued))
        self._current = Current(queued.goal, queued.share, queued.tolerances, asked_s=trajectory.duration)
        if queued.until_force:
            context = self.context
            watch = ContactWatch(self.name, context.force_sensors, context.model, queued.until_force)
            self._current.contact = watch
        self._note_asked(self._current, queued, trajectory)
        self._begun()

    def _note_asked(self, current: Current, queued: Queued, trajectory: Trajectory) -> None:
        """Note what tolerances of the client hold against: the trajectory as it came, from when it could have begun."""
        if isinstance(trajectory, TrackedTrajectory):
            current.asked, current.passed_s = trajectory, trajectory.begin_s
        elif isinstance(trajectory, RetimedTrajectory):
            current.retimed, current.asked = trajectory, trajectory.asked
            current.asked_s = trajectory.asked.duration
            if queued.policy is not Policy.APPEND:
                current.passed_s = (queued.ticks + 1) * self.planner.period_s

    # ends

    def _replaced(self, goal: Goal) -> ImError:
        return ImError(
            f"group '{self.name}': replaced by goal {goal.id}", code="replaced", group=self.name, goal=goal.id
        )

    def _require_free(self, policy: Policy) -> None:
        self.require_released()
        goal = self.goal
        if policy is Policy.REFUSE and goal is not None:
            raise StateError(
                f"group '{self.name}' is moving (goal {goal.id}); wait for its end or cancel it", group=self.name
            )

    def _interrupt(self, fault: ImError) -> None:
        """End the motion under way early; the motions queued behind end at once."""
        current = self._current
        if current is not None and current.goal.fault is None:
            current.goal.fault = fault
            current.at_once = self.still
        self._end_queued(0, fault)

    def _end_all(self, fault: ImError) -> None:
        self._interrupt(fault)
        self._rates.protective = None

    def _end_queued(self, rank: int, fault: ImError) -> None:
        """End the waiting motion of a rank, and all motions queued behind."""
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
        results: dict[str, Any] = {"duration": ticks * self.planner.period_s}
        current = self._current
        if current is not None and current.goal is goal:
            if current.retimed is not None:
                results["retimed"] = current.retimed.report
            if current.contact is not None:
                fault = current.contact.verdict(fault)
                results["force"] = current.contact.force
        self._ended.append((goal, fault, results))

    def _suspended(self, fault: ImError) -> None:
        self._patience_ticks -= 1
        if self._patience_ticks < 0:
            self._end_all(fault)
            self._close_gate(fault)

    def _close_gate(self, fault: ImError) -> None:
        """Close the gate of a stopped stream: the next setpoint must not restart the stream."""
        if self._current is not None and (lease := self._current.lease) is not None:
            self.gate.close(lease.owner, lease.seconds, fault)

    def _check_lease(self, current: Current, lease: StreamLease) -> None:
        if current.goal.fault is None:
            lease.tick()
            fault = lease.lapsed()
            if fault is not None:
                self._interrupt(fault)
                current.at_once = False

    def _waits(self) -> bool:
        """Return whether a stream stands at the target until the next one comes."""
        return self._current is not None and self._current.stream is not None and self.planner.still

    def _judge_end(self, fault: ImError | None) -> None:
        """End the goal under way at the end, or after an early stop."""
        current, planner = self._current, self.planner
        assert current is not None
        if fault is not None:
            if self.still and (current.at_once or self.settled):
                self._end_current(fault)
                self.hold(planner.setpoint.q)
        elif planner.finished and self.still and self.check.at_end(current):
            self._end_current(self.check.fault)

    def _begun(self) -> None:
        self.monitor.restart()
        self.controller.hold_integral(False)
