"""MCS in one tick: read the slots, obey requests, plan, control, limit, write the slots."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from im_core.errors import ImError, LimitError, LinkError, NotFoundError, StateError
from im_mcs.client.requests import Request, check_path, check_speed_scale, parse_request
from im_mcs.config import McsConfig
from im_mcs.control.guard import ControlLawError
from im_mcs.control.velocity import VelocityEstimator
from im_mcs.limits import JointLimits
from im_mcs.model import Model
from im_mcs.planning import JointPath, Setpoint
from im_mcs.servo.gripper import GripperMotion
from im_mcs.servo.group import ControlledGroup, Goal, make_group
from im_mcs.state import Event, State
from im_mcs.state.manager import StateManager
from im_mcs.testbed import Drive, Measured, TestbedInterface

Emit = Callable[[dict[str, Any]], None]
_PROGRESS_S = 0.1


class Mcs:
    """The four layers and the state manager; knows neither processes nor clocks.

    Attributes:
        control_model: Dynamics in the eyes of the control laws; wrong where the configuration wants it so.
        manager: State manager.
        groups: Every group of the preset.
        tau: Torques of the last tick, shape (n,).
        saturations: How many torques were cut so far.

    Args:
        config: Configuration.
        model: Kinematics and dynamics.
        testbed: The slots.
        emit: Takes replies, results and progress.
    """

    def __init__(self, config: McsConfig, model: Model, testbed: TestbedInterface, emit: Emit) -> None:
        self.config = config
        self.model = model
        self.control_model = model.wrong_by(config.model_error)
        self.testbed = testbed
        self.limits = JointLimits(model, config.limits)
        self.measured = testbed.read()
        self.v = np.zeros(model.n)
        self.tau = np.zeros(model.n)
        self.setpoint = self.measured.q.copy()
        self.gripper = self.measured.gripper.copy()
        self.saturations = 0
        self.wants_time = False
        self._emit = emit
        self._velocity = VelocityEstimator(model.n, config.servo.period_s, config.servo.velocity_bandwidth_rad_s)
        self.groups = {
            name: make_group(name, config, self.control_model, self.limits, self.measured.q) for name in config.groups
        }
        self.manager = StateManager(
            groups={name: group.joints for name, group in config.groups.items()},
            index={name: group.index for name, group in self.groups.items()},
            settings=config.servo,
            measured=self.measured,
            arms=self,
        )
        self._grippers: dict[int, GripperMotion] = {}
        self._progress_ticks = max(1, round(_PROGRESS_S / config.servo.period_s))

    def tick(self, messages: Iterable[dict[str, Any]]) -> None:
        """One servo tick.

        Args:
            messages: Requests that have arrived since the last tick.

        Raises:
            LinkError: The testbed no longer listens.
        """
        m = self.measured = self.manager.measured = self.testbed.read()
        self.v = self._velocity.update(m.q)
        for message in messages:
            self.obey(message)
        self.manager.tick()
        self._watch(m)
        self._control(m)
        self._finish_goals(m)
        self._finish_grippers(m)
        settling = any(group.engaged and not group.settled for group in self.groups.values())
        self.wants_time = self.manager.busy or settling or bool(self._grippers)
        self.testbed.write(Drive(self.tau, self.manager.power, self.manager.brakes, self.gripper, self.wants_time))

    def refuse(self, message: dict[str, Any], error: ImError) -> None:
        """Answer a request that cannot even be looked at."""
        self._answer(int(message.get("id", 0)), error)

    def obey(self, message: dict[str, Any]) -> None:
        """Obey one request; refusals are answered, never raised."""
        number = int(message.get("id", 0))
        try:
            self._obey(parse_request(message))
        except ImError as error:
            self._answer(number, error)

    def stop_all(self, fault: ImError) -> None:
        """Protective stop: every motion decelerates and ends with ``fault``."""
        for group in self.groups.values():
            group.stop(fault)

    def lose_testbed(self, error: LinkError) -> None:
        """The testbed has stopped listening; whatever was powered is estopped, and what was measured is forgotten."""
        self._protect(error.message)
        self._velocity.reset()
        for group in self.groups.values():
            group.monitor.restart()

    # what the state manager asks for (im_mcs.state.manager.Arms)

    def engage(self, groups: Sequence[str]) -> None:
        """Let groups hold where they are measured to be."""
        for name in groups:
            group = self.groups[name]
            group.engage(self.measured.q[group.index])

    def disengage(self) -> None:
        """No setpoints and no torques any more."""
        for group in self.groups.values():
            group.disengage()

    def drop(self, reason: ImError) -> None:
        """End every goal with ``reason``, at once."""
        for group in self.groups.values():
            goal, group.goal = group.goal, None
            if goal is not None:
                self._result(group, goal, reason)
        self.gripper = self.measured.gripper.copy()
        for motion in self._grippers.values():
            self._answer(motion.id, reason)
        self._grippers.clear()
        self.disengage()

    def moving(self) -> str | None:
        """A group that has a goal."""
        return next((group.name for group in self.groups.values() if group.goal is not None), None)

    def settled(self) -> bool:
        """Whether every engaged group is at rest or given up on."""
        return all(group.settled for group in self.groups.values() if group.engaged)

    def _obey(self, request: Request) -> None:
        event, arguments = request.event, request.arguments
        match event:
            case Event.RESERVE:
                self.manager.reserve(str(arguments["group"]))
            case Event.RELEASE:
                self.manager.release(str(arguments["group"]))
            case Event.ESTOP:
                self.manager.estop(str(arguments["reason"]))
            case Event.MOVE:
                self._move(request)
                return
            case Event.CANCEL:
                self._cancel(int(arguments["goal"]))
            case Event.SET_GRIPPER:
                self._set_gripper(request)
                return
            case Event.SET_CONTROLLER:
                self._set_controller(str(arguments["group"]), str(arguments["controller"]))
            case _:
                self.manager.begin(event, lambda error: self._answer(request.id, error))
                return
        self._answer(request.id, None)

    def _move(self, request: Request) -> None:
        name = str(request.arguments["group"])
        self.manager.check(Event.MOVE)
        self.manager.reservations.require(name)
        group = self.groups[name]
        group.require_idle()
        scale = check_speed_scale(float(request.arguments["speed_scale"]))
        points = check_path(self.limits, group.index, request.arguments["points"], self.config.planning.max_points)
        path = JointPath(
            group.planner.setpoint.q,
            points,
            self.limits.motion.of(group.index).scaled(scale),
            self.config.planning.synchrony,
        )
        group.start(Goal(request.id, self.measured.tick), path)

    def _cancel(self, goal_id: int) -> None:
        for group in self.groups.values():
            if group.goal is not None and group.goal.id == goal_id:
                group.stop(ImError("the motion was cancelled", code="cancelled", group=group.name))
                return
        raise StateError(f"goal {goal_id} is not under way", goal=goal_id)

    def _set_controller(self, name: str, law: str) -> None:
        self.manager.check(Event.SET_CONTROLLER)
        self.manager.reservations.require(name)
        self.groups[name].switch(law)

    def _set_gripper(self, request: Request) -> None:
        self.manager.check(Event.SET_GRIPPER)
        name, opening = str(request.arguments["gripper"]), float(request.arguments["opening"])
        names = [slot.name for slot in self.config.gripper_slots]
        if name not in names:
            raise NotFoundError(kind="gripper", name=name, known=names)
        stroke = self.model.cell.gripper.stroke
        if not 0.0 <= opening <= stroke:
            raise LimitError(
                joint=name, value=opening, limit=stroke if opening > 0.0 else 0.0, unit="m", what="opening"
            )
        slot = names.index(name)
        if slot in self._grippers:
            raise StateError(f"{name} is moving; wait for its end", gripper=name)
        self.gripper = self.gripper.copy()
        self.gripper[slot] = opening
        self._grippers[slot] = GripperMotion(request.id, slot, float(self.measured.gripper[slot]))

    def _watch(self, m: Measured) -> None:
        """E-stop on what no controller can mend."""
        if self.manager.state not in (State.ACTIVE, State.MOTION):
            return
        if not m.power and self.manager.power:
            self._protect(f"the testbed cut the power at tick {m.tick}")
        elif not np.isfinite(m.q).all():
            joint = self.model.names[int(np.argmin(np.isfinite(m.q)))]
            self._protect(f"{joint} gave no reading at tick {m.tick}")
        elif (fault := self.limits.overspeed(self.v)) is not None:
            self._protect(fault.message, **fault.facts)
        else:
            for group in self.groups.values():
                if group.engaged and (excess := group.following_fault(m.tick, m.q)) is not None:
                    self._protect(excess.message, **excess.facts)

    def _protect(self, reason: str, **facts: object) -> None:
        if self.manager.state in (State.RESERVED, State.ACTIVE, State.MOTION):
            self.manager.estop(reason, **facts)

    def _control(self, m: Measured) -> None:
        tau = np.zeros(self.model.n)
        wanted = Setpoint.at_rest(m.q)
        self.setpoint = wanted.q
        engaged = [group for group in self.groups.values() if group.engaged]
        if engaged:
            for group in engaged:
                wanted.put(group.index, group.planner.advance())
            gravity = self.control_model.gravity(m.q)
            try:
                for group in engaged:
                    tau[group.index] = group.torque(m.tick, m.q, self.v, gravity, wanted)
            except ControlLawError as fault:
                self._protect(f"{fault.message}, at tick {m.tick}", **fault.facts)
                tau[:] = 0.0
            tau, cut = self.limits.clip_torque(tau)
            self.saturations += cut
        for group in self.groups.values():
            if not group.engaged:
                group.monitor.update(m.tick, m.q[group.index], None)
        self.tau = tau

    def _finish_goals(self, m: Measured) -> None:
        for group in self.groups.values():
            ended = group.ended()
            if ended is not None:
                self._result(group, *ended)
            elif group.goal is not None and (m.tick - group.goal.since_tick) % self._progress_ticks == 0:
                self._emit(
                    {
                        "event": "progress",
                        "id": group.goal.id,
                        "progress": group.planner.progress,
                        "point": group.planner.point,
                    }
                )

    def _finish_grippers(self, m: Measured) -> None:
        for motion in [motion for motion in self._grippers.values() if motion.update(m.gripper)]:
            del self._grippers[motion.slot]
            self._answer(motion.id, None, opening=motion.last)

    def _result(self, group: ControlledGroup, goal: Goal, fault: ImError | None) -> None:
        duration = (self.measured.tick - goal.since_tick) * self.config.servo.period_s
        self._answer(goal.id, fault, duration=duration)

    def _answer(self, number: int, error: ImError | None, **results: object) -> None:
        message: dict[str, Any] = {"event": "reply", "id": number, "success": error is None, "results": results}
        if error is not None:
            message["error"] = {"code": error.code, "message": error.message, "facts": error.facts}
        self._emit(message)
