"""Requests of clients: checked against state and reservations, then done."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from im_core.errors import ImError, StateError
from im_mcs.client.requests import Request, parse_request, request_id
from im_mcs.model import Payload
from im_mcs.servo.group import ControlledGroup, Goal
from im_mcs.state import Event

if TYPE_CHECKING:
    from im_mcs.servo.core import Mcs

_LATER = frozenset({Event.MOVE, Event.STREAM, Event.SET_GRIPPER})
"""Requests whose reply comes when what they ask for has ended."""


class Obeying:
    """What each request does.

    Args:
        mcs: The machine.
    """

    def __init__(self, mcs: "Mcs") -> None:
        self._mcs = mcs
        self._manager = mcs.manager
        self._steps: Mapping[Event, Callable[[Request, dict[str, Any]], None]] = {
            Event.RESERVE: lambda _, a: self._manager.reserve(a["group"], a["owner"], a["lease_s"]),
            Event.RELEASE: lambda _, a: self._manager.release(a["group"]),
            Event.RENEW: lambda _, a: self._manager.renew(a["owner"]),
            Event.REPARTITION: lambda _, a: mcs.repartition(a["preset"]),
            Event.ESTOP: lambda _, a: mcs.estop(StateError(a["reason"])),
            Event.PROTECTIVE_STOP: self._protective_stop,
            Event.MOVE: self._move,
            Event.STREAM: self._stream,
            Event.CANCEL: self._cancel,
            Event.PAUSE: self._pause,
            Event.RESUME: self._resume,
            Event.SET_SPEED: self._set_speed,
            Event.SET_GRIPPER: self._set_gripper,
            Event.SET_CONTROLLER: self._set_controller,
            Event.SET_PAYLOAD: self._set_payload,
        }

    def obey(self, message: Mapping[str, Any]) -> None:
        """Obey one request; refusals are answered, never raised."""
        number = request_id(message)
        answers = self._mcs.answers
        try:
            request = parse_request(message)
            step = self._steps.get(request.event)
            if step is None:
                self._manager.begin(request.event, lambda error: answers.reply(number, error))
                return
            step(request, request.arguments)
        except ImError as error:
            answers.reply(number, error)
            return
        if request.event not in _LATER:
            answers.reply(number, None)

    def _move(self, request: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.MOVE)
        self._manager.reservations.require_lease(a["group"])
        self._mcs.loop.driving.require_free(a["group"])
        self._mcs.groups[a["group"]].request(self._goal(request), a)

    def _stream(self, request: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.STREAM)
        self._manager.reservations.require_owner(a["group"], a["owner"])
        group, goal = self._mcs.groups[a["group"]], self._goal(request)
        if a["kind"] == "torque":
            opened = self._mcs.loop.driving.stream(group, goal, a)
        else:
            self._mcs.loop.driving.require_free(a["group"])
            opened = group.stream(goal, a)
        if not opened:
            self._mcs.answers.reply(request.id, None)

    def _cancel(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.CANCEL)
        if self._mcs.grippers.cancel(a["goal"], _cancelled(""), self._mcs.measured.gripper):
            return
        driven = self._mcs.loop.driving.cancel(a["goal"])
        if driven is not None:
            self._mcs.end_driving(self._mcs.loop.driving.end(_cancelled(driven), (driven,)))
            return
        for group in self._mcs.groups.values():
            try:
                group.cancel(a["goal"], _cancelled(group.name))
            except StateError:
                continue
            return
        raise StateError(f"goal {a['goal']} is not under way", goal=a["goal"])

    def _pause(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.PAUSE)
        groups = self._named(a["group"])
        for group in groups:
            self._mcs.loop.driving.require_free(group.name)
        for group in groups:
            group.pause()

    def _resume(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.RESUME)
        groups = self._named(a["group"])
        for group in groups:
            self._manager.reservations.require_lease(group.name)
        for group in groups:
            group.resume()

    def _protective_stop(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.PROTECTIVE_STOP)
        self._mcs.protective_stop(
            ImError(f"protective stop: {a['reason']}", code="protective_stop", reason=a["reason"])
        )

    def _set_speed(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.SET_SPEED)
        self._one(a["group"]).set_speed(a["scale"])

    def _set_controller(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.SET_CONTROLLER)
        self._one(a["group"]).switch(a["controller"])

    def _set_gripper(self, request: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.SET_GRIPPER)
        measured = self._mcs.measured.gripper
        self._mcs.grippers.move(request.id, a["gripper"], a["opening"], a["force"], measured)

    def _set_payload(self, _: Request, a: dict[str, Any]) -> None:
        self._manager.check(Event.SET_PAYLOAD)
        group = self._one(a["group"]).name
        config = self._mcs.config
        wrist = config.groups[group].wrist
        if wrist is None:
            raise StateError(f"group '{group}' has no wrist that could carry a payload", group=group)
        limits = config.payload
        payload = Payload.checked(a["mass"], a["center"], a["inertia"], limits.rated_kg, limits.reach_m)
        ticks = round(config.switching.handover_s / config.servo.period_s)
        self._mcs.control_model.set_payload(wrist, payload, ticks)
        for engaged in self._mcs.loop.engaged:  # of the transporter, too: every joint below carries it
            engaged.monitor.restart()

    def _goal(self, request: Request) -> Goal:
        return Goal(request.id, self._mcs.measured.tick)

    def _one(self, name: str) -> ControlledGroup:
        self._manager.reservations.require(name)
        return self._mcs.groups[name]

    def _named(self, name: str) -> list[ControlledGroup]:
        """A reserved group, or all of them for an empty name."""
        names = [name] if name else self._manager.reservations.groups
        return [self._one(name) for name in names]


def _cancelled(group: str) -> ImError:
    """The fault of a cancelled motion of a group; empty: of a gripper."""
    return ImError("the motion was cancelled", code="cancelled", group=group)
