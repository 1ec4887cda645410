"""Requests to MCS as they reach the servo process, and their checks."""

import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from im_core.errors import DataError, NotFoundError
from im_mcs.planning.arguments import SLOWEST
from im_mcs.planning.values import is_number, is_real
from im_mcs.state.table import Event

_NEEDED = object()


@dataclass(frozen=True)
class _Field:
    """An argument of a request.

    Attributes:
        what: What it is, in words.
        holds: Whether a value is that.
        default: What it is if not given.
    """

    what: str
    holds: Callable[[Any], bool]
    default: object = _NEEDED

    def otherwise(self, default: object) -> "_Field":
        """The same, with a value to take if none is given."""
        return _Field(self.what, self.holds, default)


def _are_numbers(value: object) -> bool:
    return isinstance(value, list) and all(map(is_real, value))


_TEXT = _Field("a text", lambda value: isinstance(value, str))
_COUNT = _Field("a whole number", lambda value: isinstance(value, int) and not isinstance(value, bool))
_SECONDS = _Field("a finite number >= 0 [s]", lambda value: is_number(value) and value >= 0.0)
_LONGEST_LEASE_S = 10.0
_LEASE = _Field(
    f"a number above 0 and up to {_LONGEST_LEASE_S:g} [s], the time after which a silent sender is given up on",
    lambda value: is_number(value) and 0.0 < value <= _LONGEST_LEASE_S,
)
_AMOUNT = _Field("a finite number >= 0", lambda value: is_number(value) and value >= 0.0)
_LENGTH = _Field("a number [m]", is_real)
_SPEED = _Field(f"a number from {SLOWEST:g} to 1", lambda value: is_number(value) and SLOWEST <= value <= 1.0)
_SHARE = _Field(f"0 or {_SPEED.what}", lambda value: value == 0.0 or _SPEED.holds(value))
_NUMBERS = _Field("a list of numbers", _are_numbers)
_VECTOR = _Field(
    "3 finite numbers", lambda value: _are_numbers(value) and len(value) == 3 and all(map(is_number, value))
)
_INERTIA = _Field(
    "6 finite numbers (xx, xy, xz, yy, yz, zz)",
    lambda value: _are_numbers(value) and len(value) == 6 and all(map(is_number, value)),
)
_PATH = _Field(
    "a path of kind joint, line or trajectory",
    lambda value: isinstance(value, dict) and value.get("kind") in ("joint", "line", "trajectory"),
)


def _one_of(*names: str) -> _Field:
    return _Field("one of " + ", ".join(names), lambda value: isinstance(value, str) and value in names)


_FIELDS: Mapping[Event, Mapping[str, _Field]] = {
    Event.RESERVE: {"group": _TEXT, "owner": _TEXT.otherwise(""), "lease_s": _SECONDS.otherwise(0.0)},
    Event.RELEASE: {"group": _TEXT},
    Event.RENEW: {"owner": _TEXT},
    Event.REPARTITION: {"preset": _TEXT},
    Event.MOVE: {
        "group": _TEXT,
        "path": _PATH,
        "policy": _one_of("refuse", "append", "replace").otherwise("refuse"),
        "speed_scale": _SHARE.otherwise(0.0),
    },
    Event.STREAM: {
        "group": _TEXT,
        "kind": _one_of("setpoint", "torque"),
        "positions": _NUMBERS.otherwise([]),
        "velocities": _NUMBERS.otherwise([]),
        "torques": _NUMBERS.otherwise([]),
        "lease_s": _LEASE,
        "owner": _TEXT.otherwise(""),
    },
    Event.CANCEL: {"goal": _COUNT},
    Event.PAUSE: {"group": _TEXT.otherwise("")},
    Event.RESUME: {"group": _TEXT.otherwise("")},
    Event.SET_SPEED: {"group": _TEXT, "scale": _SPEED},
    Event.SET_GRIPPER: {"gripper": _TEXT, "opening": _LENGTH, "force": _AMOUNT.otherwise(0.0)},
    Event.SET_CONTROLLER: {"group": _TEXT, "controller": _TEXT},
    Event.SET_PAYLOAD: {"group": _TEXT, "mass": _AMOUNT, "center": _VECTOR, "inertia": _INERTIA},
    Event.PROTECTIVE_STOP: {"reason": _TEXT},
    Event.ESTOP: {"reason": _TEXT},
}
_SERVO_EVENTS = {
    event.value: event for event in Event if event not in (Event.CONFIGURE, Event.CLEANUP, Event.RELEASE_LAST)
}


@dataclass(frozen=True)
class Request:
    """One request.

    Attributes:
        id: Number that the answer carries.
        event: What is asked for.
        arguments: What the event needs; those left out have their defaults once parsed.
    """

    id: int
    event: Event
    arguments: dict[str, Any] = field(default_factory=dict)

    def to_message(self) -> dict[str, Any]:
        """The request as JSON data."""
        return {"id": self.id, "request": self.event.value, "arguments": self.arguments}


def parse_request(message: Mapping[str, Any]) -> Request:
    """A request from JSON data, with every argument of the schema.

    Raises:
        NotFoundError: The servo knows no such request.
        DataError: An argument is missing, too much, or not what it should be; it is named.
    """
    name = message.get("request")
    if not isinstance(name, str) or name not in _SERVO_EVENTS:
        raise NotFoundError(kind="request", name=str(name), known=_SERVO_EVENTS)
    event = _SERVO_EVENTS[name]
    fields = _FIELDS.get(event, {})
    given = message.get("arguments", {})
    if not isinstance(given, dict):
        raise DataError(f"{name}: the arguments are not an object but {reprlib.repr(given)}", request=name)
    if not given.keys() <= fields.keys() or any(f.default is _NEEDED and n not in given for n, f in fields.items()):
        takes = ", ".join(n if f.default is _NEEDED else f"[{n}]" for n, f in fields.items())
        raise DataError(
            f"{name} takes {takes or 'no arguments'}, not {', '.join(sorted(given)) or 'none'}", request=name
        )
    for argument, value in given.items():
        if not fields[argument].holds(value):
            raise DataError(
                f"{name}: {argument} is {fields[argument].what}, not {reprlib.repr(value)}",
                request=name,
                argument=argument,
            )
    arguments = {argument: given.get(argument, f.default) for argument, f in fields.items()}
    return Request(request_id(message), event, arguments)


def request_id(message: Mapping[str, Any]) -> int:
    """Number of a request, 0 if it has none."""
    number = message.get("id", 0)
    return number if isinstance(number, int) else 0
