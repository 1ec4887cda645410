"""Requests of clients: checked against state and reservations, then done."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, Protocol

import numpy as np

from im_core.errors import DataError, ImError, NotFoundError, StateError
from im_mcs.collision.surroundings import CollisionScene
from im_mcs.group import ControlledGroup
from im_mcs.group.goals import Goal
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import CellModel, ControlledModel, Payload
from im_mcs.protocol.requests import (
    CancelRequest,
    CollisionSceneRequest,
    EstopRequest,
    MoveRequest,
    PauseRequest,
    ProtectiveStopRequest,
    QueryRequest,
    ReleaseRequest,
    RenewRequest,
    RepartitionRequest,
    ReserveRequest,
    ResetRequest,
    ResumeRequest,
    Sender,
    ServoRequest,
    SetControllerRequest,
    SetGripperRequest,
    SetPayloadRequest,
    SetSpeedRequest,
    StreamRequest,
    TakeOverRequest,
    TransitionRequest,
    parse_request,
    request_id,
)
from im_mcs.servo.answers import Answers
from im_mcs.servo.control_loop import ControlLoop
from im_mcs.servo.gripper import Grippers
from im_mcs.servo.torque_stream import Ended
from im_mcs.state import Event
from im_mcs.state.manager import StateManager
from im_mcs.testbed import Measured

#: What is done though whoever asked for it no longer waits.
_STOPS = (Event.ESTOP.value, Event.PROTECTIVE_STOP.value)


class Machine(Protocol):
    """Target of requests: :class:`im_mcs.servo.core.Mcs`, with the attributes and methods."""

    config: McsConfig
    model: CellModel
    manager: StateManager
    groups: dict[str, ControlledGroup]
    loop: ControlLoop
    grippers: Grippers
    control_model: ControlledModel
    answers: Answers
    measured: Measured

    def repartition(self, preset: str, sender: Sender) -> None:
        """Divide the joints into the groups of another preset."""
        ...

    def surround(self, around: CollisionScene) -> None:
        """Watch other free bodies and contacts."""
        ...

    def protective_stop(self, fault: ImError, *, latched: bool) -> None:
        """Decelerate all groups on the paths and hold the groups."""
        ...

    def estop(self, fault: ImError) -> None:
        """Stop at once."""
        ...

    def end_torque_streams(self, ended: Iterable[Ended]) -> None:
        """Let the laws of groups driven by torques take over."""
        ...


class Dispatch:
    """Effect of each request."""

    def __init__(self, mcs: Machine) -> None:
        self._mcs = mcs
        self._manager = mcs.manager
        planning = mcs.config.planning
        self._most = planning.max_points, planning.max_trajectory_points

    def run_all(self, messages: Iterable[Mapping[str, Any]]) -> None:
        """Carry out requests heard together; cancelled ones are not begun, except stops."""
        heard = list(messages)
        cancelled = {_cancelled_goal(message) for message in heard} - {None}
        withdrawn: set[int] = set()
        for message in heard:
            number = request_id(message)
            if number in cancelled and message.get("request") not in _STOPS:
                withdrawn.add(number)
                fault = ImError("the request was cancelled before its start", code="cancelled", group="")
                self._mcs.answers.reply(number, fault)
            elif _cancelled_goal(message) in withdrawn:
                self._mcs.answers.reply(number, None)
            else:
                self.run(message)

    def run(self, message: Mapping[str, Any]) -> None:
        """Carry out one request; refusals are answered, never raised."""
        number = request_id(message)
        try:
            name, request = parse_request(message, *self._most)
            replied_later = self._do(number, Event(name), request)
        except ImError as error:
            self._mcs.answers.reply(number, error)
        else:
            if not replied_later:
                self._mcs.answers.reply(number, None)

    def _do(self, number: int, event: Event, request: ServoRequest) -> bool:
        """Carry out a request; return whether the answer comes at the end."""
        mcs, manager = self._mcs, self._manager
        match request:
            case TakeOverRequest():
                self._take_over(number, request)
                return True
            case ReserveRequest():
                manager.reserve(request.group, request.owner, request.lease_s, request.sender)
                return False
            case ReleaseRequest():
                manager.release(request.group, request.sender, partial(mcs.answers.reply, number))
                return True
            case RenewRequest():
                manager.renew(request.owner)
                return False
            case RepartitionRequest():
                mcs.repartition(request.preset, request.sender)
                return False
            case EstopRequest():
                mcs.estop(StateError(request.reason))
                return False
            case TransitionRequest():
                reply = partial(mcs.answers.reply, number)
                manager.begin(event, reply, request.group, request.sender)
                return True
            case ResetRequest():
                manager.reset(partial(mcs.answers.reply, number))
                return True
        manager.check(event, getattr(request, "group", ""))  # those above are checked where they are carried out
        match request:
            case MoveRequest():
                manager.reservations.require_driver(request.group, request.sender)
                mcs.loop.torque_streams.require_free(request.group)
                mcs.groups[request.group].request(self._goal(number), request)
                return True
            case StreamRequest():
                return self._stream(number, request)
            case SetGripperRequest():
                self._require_jaws(request)
                mcs.grippers.move(number, request, mcs.measured.gripper)
                return True
            case QueryRequest():
                mcs.answers.reply(number, None, self._query(request))
                return True
            case CancelRequest():
                self._cancel(request.goal)
            case PauseRequest():
                self._pause(self._named(event, request.group))
            case ResumeRequest():
                # all or none: a refusal comes before any group moves
                held, every = manager.reservations, not request.group
                groups = self._named(event, request.group, request.sender) if held.groups or not every else []
                for group in groups:
                    held.require_driver(group.name, request.sender)
                groups += [group for name, group in mcs.groups.items() if every and held.of(name) is None]
                for group in groups:
                    group.resume()
            case SetSpeedRequest():
                self._owned(request.group, request.sender).set_speed(request.scale)
            case SetControllerRequest():
                self._owned(request.group, request.sender).switch(request.controller, request.parameters)
            case SetPayloadRequest():
                self._set_payload(request)
            case CollisionSceneRequest():
                mcs.surround(CollisionScene(tuple(request.things), tuple(request.contacts)))
            case ProtectiveStopRequest():
                reason = request.reason
                stop = ImError(f"protective stop: {reason}", code="protective_stop", reason=reason)
                mcs.protective_stop(stop, latched=True)
        return False

    def _stream(self, number: int, request: StreamRequest) -> bool:
        """Take streaming setpoints or torques; return whether a goal was opened, with the answer at the end."""
        mcs = self._mcs
        self._manager.reservations.require_driver(request.group, Sender(names=[request.owner]))
        group, goal = mcs.groups[request.group], self._goal(number)
        group.gate.require_open(request.owner)
        if request.kind == "torque":
            return mcs.loop.torque_streams.take_torques(group, goal, request)
        mcs.loop.torque_streams.require_free(request.group)
        return group.stream(goal, request)

    def _require_jaws(self, request: SetGripperRequest) -> None:
        """Check whether the sender drives the arm with a gripper, if that is reserved, or may drive every gripper.

        Raises:
            StateError: It belongs to another owner, who is named, or the lease has lapsed.
        """
        mcs, reservations, names = self._mcs, self._manager.reservations, request.sender.names
        if any(name.rpartition("/")[2] in mcs.config.gripper_nodes for name in names):
            return
        for slot in mcs.config.gripper_slots:
            if slot.name == request.gripper:
                joint = mcs.model.joints_below(mcs.model.cell.devices("gripper")[slot.name])[-1]
                for name, group in mcs.groups.items():
                    if joint in group.index and reservations.of(name) is not None:
                        reservations.require_driver(name, request.sender)

    def _query(self, request: QueryRequest) -> dict[str, object]:
        """Return the state of the trajectory of a group at a time.

        Raises:
            StateError: There is none then.
        """
        group = self._mcs.groups[request.group]
        if group.goals and (fault := group.goals[0].fault) is not None:
            raise StateError(f"group '{group.name}' leaves its trajectory: {fault.message}", group=group.name)
        seconds = 1e-9 * (request.stamp_ns - self._mcs.measured.stamp_ns) + group.planner.period_s
        at = group.planner.at(seconds)  # its setpoint is still that of the tick before
        return {"q": at.q.tolist(), "v": at.v.tolist(), "a": at.a.tolist()}

    def _pause(self, groups: list[ControlledGroup]) -> None:
        """Pause all paths; a group driven by torques has none, and is named after all others halt.

        Raises:
            StateError: A group is driven by torques.
        """
        streams = self._mcs.loop.torque_streams
        halted = [group for group in groups if streams.goal(group.name) is None]
        for group in halted:
            group.pause()
        for group in groups:
            if (goal := streams.goal(group.name)) is not None:
                others = f"; {', '.join(each.name for each in halted)} paused" if halted else ""
                raise StateError(
                    f"group '{group.name}' is driven by torques (goal {goal.id}) and does not pause: cancel that, or "
                    f"ask for a protective stop{others}",
                    group=group.name,
                )

    def _cancel(self, goal: int) -> None:
        mcs = self._mcs
        if mcs.grippers.cancel(goal, _cancelled(""), mcs.measured.gripper):
            return
        driven = mcs.loop.torque_streams.cancel(goal)
        if driven is not None:
            mcs.end_torque_streams(mcs.loop.torque_streams.end_streams(_cancelled(driven), (driven,)))
            return
        for group in mcs.groups.values():
            try:
                group.cancel(goal, _cancelled(group.name))
            except StateError:
                continue
            return
        raise StateError(f"goal {goal} is not under way", goal=goal)

    def _set_payload(self, request: SetPayloadRequest) -> None:
        group, config = self._owned(request.group, request.sender).name, self._mcs.config
        wrists = config.groups[group].frames
        if not wrists:
            raise StateError(f"group '{group}' has no wrist that could carry a payload", group=group)
        if not request.wrist and len(wrists) > 1:
            raise DataError(f"group '{group}' has the wrists {' and '.join(wrists)}: name the one that carries it")
        wrist = request.wrist or wrists[0]
        if wrist not in wrists:
            raise NotFoundError(kind=f"wrist of group '{group}'", name=wrist, known=wrists)
        limits = config.payload
        payload = Payload.checked(request.mass, request.center, request.inertia, limits.rated_kg, limits.reach_m)
        ticks = round(config.switching.handover_s / config.servo.period_s)
        self._mcs.control_model.set_payload(wrist, payload, ticks)
        below = self._mcs.model.joints_below(wrist)
        for engaged in self._mcs.loop.engaged:  # of carriers in a group of their own, too: every joint below carries it
            if np.isin(engaged.index, below).any():
                engaged.monitor.restart()

    def _goal(self, number: int) -> Goal:
        return Goal(number, self._mcs.measured.tick, self._mcs.measured.stamp_ns)

    def _take_over(self, number: int, request: TakeOverRequest) -> None:
        """Change the owner of a group; the former motion ends on the path, and the answer names the former owner."""
        mcs, name = self._mcs, request.group
        before = self._manager.take_over(name, request.owner, request.lease_s, request.sender)
        fault = StateError(f"group '{name}' was taken over for '{request.owner}'", group=name, owner=request.owner)
        mcs.end_torque_streams(mcs.loop.torque_streams.end_streams(fault, (name,)))
        mcs.groups[name].stop(fault)
        mcs.answers.reply(number, None, {"owner": before})

    def _owned(self, name: str, sender: Sender) -> ControlledGroup:
        self._manager.reservations.require_owner(name, sender)
        return self._mcs.groups[name]

    def _named(self, event: Event, name: str, sender: Sender | None = None) -> list[ControlledGroup]:
        """Return a group, or for an empty name all of the sender's, or everybody's, in a state for ``event``."""
        names = [name] if name else self._manager.allowed(event, sender)
        return [self._mcs.groups[each] for each in names]


def _cancelled_goal(message: Mapping[str, Any]) -> int | None:
    """Return the number of the request cancelled by a request; None for any other request."""
    arguments = message.get("arguments")
    if message.get("request") != Event.CANCEL.value or not isinstance(arguments, dict):
        return None
    goal = arguments.get("goal")
    return goal if type(goal) is int and goal > 0 else None


def _cancelled(group: str) -> ImError:
    """The fault of a cancelled motion of a group; empty: of a gripper."""
    return ImError("the motion was cancelled", code="cancelled", group=group)
