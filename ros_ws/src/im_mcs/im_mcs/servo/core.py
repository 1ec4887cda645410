"""MCS in one tick: read the slots, obey requests, watch, plan, control, limit, write the slots, look around."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, LinkError
from im_mcs.collision.guard import GuardedMonitor
from im_mcs.collision.surroundings import CollisionScene
from im_mcs.control import LawSource
from im_mcs.control.filters import VelocityEstimator
from im_mcs.group import ControlledGroup
from im_mcs.group.goals import Goal
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.saturation import Saturations
from im_mcs.model import CellModel, ControlledModel
from im_mcs.protocol.evidence import Recorder
from im_mcs.protocol.requests import Sender, request_id
from im_mcs.safety import Reaction, SafetyFinding, Situation, Supervisor
from im_mcs.safety.stop_mark import StopLatch
from im_mcs.servo.answers import Answers, Emit
from im_mcs.servo.awaited import AwaitedOwners
from im_mcs.servo.control_loop import ControlLoop
from im_mcs.servo.course import Courses
from im_mcs.servo.dispatch import Dispatch
from im_mcs.servo.gripper import Grippers
from im_mcs.servo.partition import Partitions
from im_mcs.servo.torque_stream import Ended
from im_mcs.state import POWERED, Event, State
from im_mcs.state.manager import StateManager
from im_mcs.testbed import Drive, TestbedInterface


class Mcs:
    """The four layers and the state manager; knows neither processes nor clocks.

    Attributes:
        config: Configuration, with the preset in force.
        model: Kinematics and dynamics.
        limits: Limits of all joints.
        control_model: Dynamics in the eyes of the control laws; wrong where the configuration wants it so.
        manager: State manager.
        groups: Every group of the preset in force, by name.
        loop: Groups under control, their setpoints and torques.
        measured: What the slots said in this tick.
        v: Estimated velocities, shape (n,).
        saturations: How often which limit cut what was wanted.
        wants_time: Whether simulated time must go on.
        held: Whether it stands all the same, for an owner who is awaited; see :meth:`go_on`.
        situation: What the watches see; the process tells it of overruns and of its owner.

    Args:
        config: Configuration.
        model: Kinematics and dynamics.
        testbed: The slots.
        emit: Takes replies, results and progress.
        recorder: Keeps the last seconds.
        awaited: For whom simulated time stands while others want it; None: for nobody.
        latch: Keeps an emergency stop beyond the life of this process; MCS begins estopped where one is kept.

    Raises:
        LinkError: The testbed does not answer.
        ConfigError: A control law cannot be loaded.
    """

    def __init__(
        self,
        config: McsConfig,
        model: CellModel,
        testbed: TestbedInterface,
        emit: Emit,
        recorder: Recorder,
        awaited: AwaitedOwners | None = None,
        latch: StopLatch | None = None,
    ) -> None:
        self.config, self.model, self.recorder = config, model, recorder
        self._testbed = testbed
        self.measured = self._testbed.read()
        self.v = np.zeros(model.n)
        self.wants_time = self.held = False
        self._awaited = awaited
        self._latch, self._kept = latch, False
        self._untold: list[tuple[Goal, ImError]] = []
        self.limits = JointLimits(model.cell, config.limits, config.slots)
        self.saturations = Saturations(model.n)
        self.control_model = ControlledModel(model.cell, config.model_error)
        self.answers = Answers(emit, recorder, config.servo.period_s)
        self.loop = ControlLoop(config, self.limits, self.control_model, self.saturations, self.measured.q)
        self._velocity = VelocityEstimator(model.n, config.servo.period_s, config.servo.velocity_bandwidth_rad_s)
        self._laws = LawSource(config, self.control_model, self.limits.torque, testbed.wall_period_s)
        self._partitions = Partitions(config, model, self.limits, self._laws, lambda: self.measured.q)
        near = np.where(np.array(self.limits.units) == "m", config.planning.goal.m, config.planning.goal.rad)
        self._courses = Courses(testbed.followed, near, config.servo.period_s) if testbed.followed else None
        self.groups, self._collision = self._enter(config.preset)
        self.manager = StateManager(
            joints=model.names,
            groups={name: group.joints for name, group in config.groups.items()},
            index={name: group.index for name, group in self.groups.items()},
            settings=config.servo,
            measured=self.measured,
            arms=self,
        )
        self.situation = Situation(self.measured, self.v, self.v, self.groups, self.manager.brakes)
        self._supervisor = Supervisor.make(config, self.limits, self.manager.reservations, self._testbed.faults)
        gripper = model.cell.gripper
        names = tuple(slot.name for slot in config.gripper_slots)
        patience_ticks = round(config.servo.settle.timeout_s / config.servo.period_s)
        self.grippers = Grippers(
            names, gripper.stroke, gripper.force, self.measured.gripper, self.answers, patience_ticks
        )
        self._dispatch = Dispatch(self)
        if latch is not None and (cause := latch.read()):  # an emergency stop outlives the process that declared it
            self.manager.estop(cause)

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Positions, velocities and accelerations followed in the current tick, shape (3, n)."""
        return self.loop.setpoint

    @property
    def tau(self) -> NDArray[np.float64]:
        """Torques of the current tick, shape (n,)."""
        return self.loop.tau

    def tick(self, messages: Iterable[dict[str, Any]]) -> None:
        """One servo tick.

        Args:
            messages: Requests that have arrived since the last tick.

        Raises:
            LinkError: The testbed does not answer, or no longer listens.
        """
        m = self.measured = self.manager.measured = self._testbed.read()
        self.v = self._velocity.update_at(m.q, m.stamp_ns, m.age_s)
        self._partitions.end_contacts(m.stamp_ns)
        self._dispatch.run_all(messages)
        self.manager.tick()
        abandoned = self.manager.state in POWERED and self._watch()
        if self._courses is not None:
            self._courses.scale(self.groups.values(), self._testbed.speed(), self.loop.following_error(m))
        for finding in self.loop.run(m, self.v):
            self._react(finding)
        self._finish()
        loop = self.loop
        busy = {name for name, group in self.groups.items() if group.wants_time}
        urgent = abandoned or self.grippers.moving or bool(loop.torque_streams)
        self.wants_time = urgent or bool(busy) or self.manager.wants_time
        self.held = self._hold(busy, urgent)
        tau, setpoint = loop.tau, loop.setpoint
        try:
            self._write()
            self._complete_stop()
            if self._courses is not None:
                self._give_course(self._courses)
            self._follow_up()
            for finding in loop.look_around(m, self.v, self._collision):  # while the testbed moves on
                self._react(finding)
        finally:
            self.recorder.put_row(m.tick, m.stamp_ns, (m.q, self.v, tau), setpoint, m.wrench)

    def go_on(self) -> None:
        """Resume simulated time: the awaited owner sent no request.

        Raises:
            LinkError: The testbed no longer listens.
        """
        if self.held and self._awaited is not None and not self._awaited.present:
            self.held = False
            self._write()

    def refuse(self, message: dict[str, Any], error: ImError) -> None:
        """Answer an impossible request; an emergency stop is always possible."""
        if message.get("request") == Event.ESTOP.value:
            self._dispatch.run(message)
            self._complete_stop()
        else:
            self.answers.reply(request_id(message), error)

    def protective_stop(self, fault: ImError, groups: Sequence[str] | None = None, *, latched: bool = False) -> None:
        """Decelerate groups on the paths and hold the groups until resumed; all groups if none are named.

        Args:
            fault: Why.
            groups: Which groups.
            latched: Whether it holds groups without goals, too.
        """
        self.end_torque_streams(self.loop.torque_streams.end_streams(fault, groups))
        for name, group in self.groups.items():
            if groups is None or name in groups:
                if group.goals and group.protective is None:
                    self.answers.accuse(fault)
                group.protective_stop(fault, latched=latched)

    def surround(self, around: CollisionScene) -> None:
        """Watch other free bodies and contacts from the present tick on.

        Raises:
            CollisionMonitorError: The collision monitor takes none.
        """
        self._partitions.surround(around)

    def end_torque_streams(self, ended: Iterable[Ended]) -> None:
        """Let the laws of groups driven by torques take over at the present place."""
        for group, goal, fault in ended:
            self.loop.engage((group,), self.measured.q)
            self.answers.drop_goal(goal, fault, self.measured.tick)

    def estop(self, fault: ImError) -> None:
        """Stop at once, by the ways of the state manager."""
        self.manager.estop(fault.message, fault.facts)

    def lose_testbed(self, error: LinkError) -> None:
        """Handle the loss of the testbed: powered groups are estopped, and measurements forgotten."""
        before = self.manager.state
        self._protect(error)
        if self.grippers.moving:
            self.grippers.drop_goals(error, self.measured.gripper)
        self.manager.lost = self.manager.lost or self.manager.state is not before
        self.recorder.keep()
        self.wants_time = self.held = False
        if self._testbed.several:  # the other hardware stops now, not when all answer again
            with suppress(LinkError):
                self._write()
        self._complete_stop()
        self._velocity.reset()
        for group in self.groups.values():
            group.monitor.restart()

    def find_testbed(self) -> None:
        """Take up the testbed again, or another one in the place: the readings count from now on.

        Raises:
            LinkError: It does not answer.
        """
        before = self.measured.gripper
        self.measured = self.manager.measured = self._testbed.read()
        self.grippers.find(before, self.measured.gripper)

    def repartition(self, preset: str, sender: Sender) -> None:
        """Divide the joints into the groups of another preset; arms at rest under power stay so.

        Raises:
            NotFoundError: There is no such preset.
            StateError: Not allowed now, or not with the groups that are reserved.
            ConfigError: A control law of a group cannot be loaded.
        """
        config, before = self.config.with_preset(preset), self.groups
        joints = {name: group.joints for name, group in config.groups.items()}
        heirs = self.manager.check_repartition(joints, preset, sender)
        held = next((group.rates.held for group in before.values() if group.rates.held is not None), None)
        self.groups, self._collision = self._enter(preset)
        for group in self.groups.values():
            group.rates.held = held
        self.manager.repartition(joints, {name: group.index for name, group in self.groups.items()}, heirs)
        for heir, names in heirs.items():
            self.groups[heir].rates.inherit([before[name].rates for name in names])
        former = [before[name] for name in dict.fromkeys(name for names in heirs.values() for name in names)]
        engaged = [self.groups[heir] for heir, names in heirs.items() if before[names[0]].engaged]
        self.loop.hand_over(former, engaged)
        self.config = config
        self.situation.groups = self.groups

    def close(self) -> None:
        """End the processes of the control laws."""
        self._laws.close()

    def _enter(self, preset: str) -> tuple[dict[str, ControlledGroup], GuardedMonitor]:
        """Return the groups of a preset, and the monitor of their collisions."""
        groups, collision = self._partitions.enter(preset)
        if self._courses is not None:
            self._courses.bind(groups.values())
        return groups, collision

    # what the state manager asks for (im_mcs.state.manager.Arms)

    def engage(self, groups: Sequence[str]) -> None:
        """Let groups hold the measured place."""
        self.loop.engage([self.groups[name] for name in groups], self.measured.q)

    def disengage(self, groups: Sequence[str]) -> None:
        """No setpoints and no commands of groups any more."""
        self.loop.disengage(groups)

    def drop_goals(self, reason: ImError) -> None:
        """End every goal with ``reason``, at once; senders are told when the power is gone."""
        self.answers.accuse(reason)
        driven = self.loop.torque_streams.end_streams(reason)
        goals = [goal for group in self.groups.values() for goal in group.drop_goals()]
        self._untold += [(goal, reason) for goal in (*goals, *(goal for _, goal, _ in driven))]
        self.grippers.drop_goals(reason, self.measured.gripper)
        self.disengage(tuple(self.groups))

    def forget_stop(self) -> None:
        """Let no later process begin with the emergency stop being reset, and no protective stop hold any more.

        Raises:
            StoreError: The mark cannot be removed.
        """
        if self._latch is not None:
            self._latch.clear()
        self._kept = False
        for group in self.groups.values():
            group.rates.held = None

    def end_goals(self, groups: Sequence[str], reason: ImError) -> None:
        """End the goals of groups with ``reason``; what moves decelerates on its path."""
        self.end_torque_streams(self.loop.torque_streams.end_streams(reason, groups))
        for name in groups:
            self.groups[name].stop(reason)

    def moving(self, groups: Sequence[str]) -> str | None:
        """Return one of the groups with a goal."""
        return self.loop.moving(groups)

    def settled(self, groups: Sequence[str]) -> bool:
        """Whether groups are at rest or given up on."""
        return all(self.groups[name].settled for name in groups)

    def broken(self) -> list[str]:
        """Return the present faults: missing, old or impossible readings, and reports of hardware."""
        m, names, bound_s = self.measured, self.model.names, self.config.safety.driver_age_estop_s
        missing = [names[rank] for rank in np.flatnonzero(~np.isfinite(m.q))]
        old = [names[rank] for rank in np.flatnonzero(m.age_s > bound_s)]
        said = [f"no reading of {', '.join(missing)}"] * bool(missing)
        said += [f"a reading older than {bound_s:g} s of {', '.join(old)}"] * bool(old)
        if impossible := self.limits.impossible(m.q):
            said.append(f"a {impossible}")
        try:
            return said + self._testbed.faults()
        except LinkError as error:
            return [*said, error.message]

    def _complete_stop(self) -> None:
        """Keep an emergency stop with power cut, then notify ended goals: power and mark come before all else.

        A loss of the testbed needs no mark: nobody has stopped the machine, and the next reservation resets it.
        """
        manager = self.manager
        if manager.state is State.ESTOPPED and not manager.lost and not self._kept:
            self._kept = True
            if self._latch is not None and (failed := self._latch.keep(manager.cause)):
                manager.cause = f"{manager.cause}; {failed}"
        untold, self._untold = self._untold, []
        for goal, reason in untold:
            self.answers.drop_goal(goal, reason, self.measured.tick)

    def _watch(self) -> bool:
        """Run the watches; return whether the owner gives no heartbeat, so power must go."""
        now = self.situation
        now.measured, now.v, now.following_error = self.measured, self.v, self.loop.following_error(self.measured)
        now.power, now.brakes = self.manager.power, self.manager.brakes
        for finding in self._supervisor.check(now):
            self._react(finding)
        bound_s = self.config.safety.owner_silence_s
        if abandoned := now.owner_silence_s > bound_s:
            self.manager.shut_down(f"the process that owns the servo gave no heartbeat for {bound_s:g} s")
        return abandoned

    def _hold(self, busy: set[str], urgent: bool) -> bool:
        """Return whether time stands for an awaited owner: only motions and transitions of other groups wait."""
        if self._awaited is None:
            return False
        manager = self.manager
        self._awaited.update(manager.states, busy | manager.under_way() if manager.busy else busy)
        urgent = urgent or manager.state is State.ESTOPPED
        return self.wants_time and not urgent and self._awaited.present

    def _write(self) -> None:
        loop, manager, grippers = self.loop, self.manager, self.grippers
        wanted = self.wants_time and not self.held
        self._testbed.write(
            Drive(loop.command, manager.power, manager.brakes, grippers.opening, wanted, grippers.force)
        )

    def _give_course(self, courses: Courses) -> None:
        course = courses.update(self.loop.engaged, self.loop.command, self._testbed.speed())
        if course is not None:
            self._testbed.follow(course)

    def _react(self, finding: SafetyFinding) -> None:
        match finding.reaction:
            case Reaction.ESTOP:
                self._protect(finding.fault)
            case Reaction.PROTECTIVE_STOP:
                self.protective_stop(finding.fault, finding.groups)
            case Reaction.END:
                self.end_torque_streams(self.loop.torque_streams.end_streams(finding.fault, finding.groups))
                for group in self.loop.engaged:
                    if group.goals and (finding.groups is None or group.name in finding.groups):
                        self.answers.accuse(finding.fault)
                        group.stop(finding.fault)

    def _protect(self, fault: ImError) -> None:
        if self.manager.state in (State.RESERVED, *POWERED):
            self.estop(fault)

    def _finish(self) -> None:
        """Report ended goals and transitions."""
        if self.loop.ended:
            ended, self.loop.ended = self.loop.ended, []
            for _, goal, fault in ended:
                self.answers.drop_goal(goal, fault, self.measured.tick)
        for group in self.groups.values():
            for goal, why, results in group.ended():
                self.answers.end_goal(goal, why, results)
        self.grippers.update(self.measured)

    def _follow_up(self) -> None:
        """Report the progress of goals; watch the rest of braked groups. No torque waits for the report."""
        m = self.measured
        for group in self.groups.values():
            self.answers.tell_progress(group, m.tick)
            if not group.engaged:
                group.monitor.update(m.tick, m.q[group.index], None)
