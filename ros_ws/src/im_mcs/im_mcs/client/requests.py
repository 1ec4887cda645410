"""Requests to MCS as they reach the servo process, and their checks."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, NotFoundError
from im_mcs.limits import JointLimits
from im_mcs.state.table import Event

_FIELDS = {
    Event.RESERVE: {"group"},
    Event.RELEASE: {"group"},
    Event.MOVE: {"group", "points", "speed_scale"},
    Event.CANCEL: {"goal"},
    Event.SET_GRIPPER: {"gripper", "opening"},
    Event.SET_CONTROLLER: {"group", "controller"},
    Event.ESTOP: {"reason"},
}
_SERVO_EVENTS = frozenset(Event) - {Event.CONFIGURE, Event.CLEANUP, Event.RELEASE_LAST}


@dataclass(frozen=True)
class Request:
    """One request.

    Attributes:
        id: Number that the answer carries.
        event: What is asked for.
        arguments: What the event needs.
    """

    id: int
    event: Event
    arguments: dict[str, Any] = field(default_factory=dict)

    def to_message(self) -> dict[str, Any]:
        """The request as JSON data."""
        return {"id": self.id, "request": self.event.value, "arguments": self.arguments}


def parse_request(message: dict[str, Any]) -> Request:
    """A request from JSON data.

    Raises:
        NotFoundError: The servo knows no such request.
        DataError: An argument is missing or too much.
    """
    name = str(message.get("request"))
    known = {event.value: event for event in _SERVO_EVENTS}
    if name not in known:
        raise NotFoundError(kind="request", name=name, known=known)
    event = known[name]
    arguments = dict(message.get("arguments", {}))
    expected = _FIELDS.get(event, set())
    if set(arguments) != expected:
        needed, given = ", ".join(sorted(expected)), ", ".join(sorted(arguments))
        raise DataError(f"{name} takes {needed or 'no arguments'}, not {given or 'none'}")
    return Request(int(message["id"]), event, arguments)


def check_path(
    limits: JointLimits, index: NDArray[np.intp], points: list[list[float]], max_points: int, first: int = 1
) -> NDArray[np.float64]:
    """Points of a path as an array, shape (m, n), if every one may be commanded.

    Raises:
        DataError: None or too many points, a wrong size, or a value that is not finite.
        LimitError: A position is out of its joint's range.
    """
    if not 1 <= len(points) <= max_points:
        raise DataError(f"a path of {len(points)} points is not one of 1 to {max_points}", points=len(points))
    numbered = enumerate(points, start=first)
    return np.array([limits.check_positions(index, point, f"point {number}") for number, point in numbered])


def check_measured_path(
    limits: JointLimits, index: NDArray[np.intp], points: list[list[float]], max_points: int
) -> NDArray[np.float64]:
    """As :func:`check_path`, for a path that begins where the group is: that may be anywhere.

    Raises:
        DataError: None or too many points, a wrong size, or a value that is not finite.
        LimitError: A position after the first is out of its joint's range.
    """
    if not points:
        raise DataError("a path of 0 points: the first is where the group is", points=0)
    start = limits.check_finite(index, points[0], "point 1")[None, :]
    if len(points) == 1:
        return start
    return np.vstack([start, check_path(limits, index, points[1:], max_points, first=2)])


def check_speed_scale(value: float) -> float:
    """Speed scale of a motion; 0 stands for 1.

    Raises:
        DataError: It is not between 0 and 1.
    """
    if not math.isfinite(value) or not 0.0 <= value <= 1.0:
        raise DataError(f"speed_scale {value} is not between 0 and 1 (0 stands for 1)", value=value)
    return value or 1.0
