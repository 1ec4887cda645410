"""Requests to the servo process: the content, checked once, at the entry.

A request is JSON: ``{"id": 7, "request": "move", "arguments": {...}}``; its name says which model its arguments obey.
The points of a trajectory are bytes in it.
What depends on the cell (the joints of a group, their limits) is not checked here but where it is known.
"""

import math
import reprlib
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import core_schema

from im_core.config import Fault, Model, faults
from im_core.errors import DataError, NotFoundError
from im_core.text.yamltext import Location
from im_mcs.collision.surroundings import AllowedContact, Thing
from im_mcs.protocol.points import TimedPoints, unpack_points

SLOWEST = 0.01
"""Smallest scale of speed: a motion slowed down further would seem to stand, and never end."""
LONGEST_LEASE_S = 10.0
"""Longest lease of a stream [s]."""
_OFF_UNIT = 0.01

LARGEST = 1e6
"""No number in a request is larger: joules, newtons, metres or seconds, it would be none of this cell."""
LONGEST_TEXT = 256
"""No text in a request is longer [characters]."""
_MOST_NUMBERS = 64
_BOUND = f", up to {LARGEST:g}"

# Descriptions say what a value is: they are what refusals say that it is not.
Text = Annotated[str, Field(max_length=LONGEST_TEXT, description=f"a text of up to {LONGEST_TEXT} characters")]
Amount = Annotated[float, Field(ge=0, le=LARGEST, description=f"a finite number >= 0{_BOUND}")]
Seconds = Annotated[float, Field(ge=0, le=LARGEST, description=f"a finite number >= 0 [s]{_BOUND}")]
Metres = Annotated[float, Field(ge=0, le=LARGEST, description=f"a finite number >= 0 [m]{_BOUND}")]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Numbers = Annotated[
    list[float], Field(max_length=_MOST_NUMBERS, description=f"a list of numbers, of up to {_MOST_NUMBERS}")
]


class Policy(StrEnum):
    """Rule for a motion under way when another is requested."""

    REFUSE = "refuse"
    APPEND = "append"
    REPLACE = "replace"


class ServoRequest(Model):
    """Arguments of a request; a number may be infinite or none where the cell's limits decide instead."""

    model_config = ConfigDict(strict=True, allow_inf_nan=True)


# paths


def _rows(kind: object) -> GetPydanticSchema:
    """Return lists of numbers for one array, shape (m, n)."""
    return GetPydanticSchema(
        lambda _, handler: core_schema.no_info_after_validator_function(_array, handler.generate_schema(kind))
    )


def _array(rows: list[list[float]]) -> NDArray[np.float64]:
    if len(set(map(len, rows))) > 1:
        number, row = next((number, row) for number, row in enumerate(rows, 1) if len(row) != len(rows[0]))
        raise ValueError(f"point {number}: {len(row)} positions; point 1 has them for {len(rows[0])} joints")
    return np.array(rows, dtype=np.float64)


def unit_pose(numbers: list[float]) -> list[float]:
    """Return position [m] and quaternion x, y, z, w of length 1, exactly; the input may be off by 1 %.

    Raises:
        ValueError: It is no pose.
    """
    if len(numbers) != 7:
        raise ValueError(f"the pose has {len(numbers)} values, not 7 (x, y, z, qx, qy, qz, qw)")
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"the pose {numbers} has a value that is not a finite number")
    if max(map(abs, numbers)) > LARGEST:
        raise ValueError(f"the pose {numbers} has a value beyond {LARGEST:g}")
    orientation = numbers[3:]
    length = math.hypot(*orientation)
    if abs(length - 1.0) > _OFF_UNIT:
        given = ", ".join(f"{number:.6g}" for number in orientation)
        raise ValueError(f"the orientation ({given}) is not a unit quaternion: its length is {length:.4g}")
    return numbers[:3] + [number / length for number in orientation]


class _Path(ServoRequest):
    """Common part of paths without times: a bound on the number of points, checked during the validation."""

    @field_validator("points", "poses", "relative", mode="before", check_fields=False)
    @classmethod
    def _count(cls, given: object, info: ValidationInfo) -> object:
        most = (info.context or {}).get("max_points")
        if isinstance(given, list) and (not given or (most is not None and len(given) > most)):
            what = {"points": "path of", "poses": "line through"}.get(info.field_name or "", "motion through")
            kind = "relative poses" if info.field_name == "relative" else info.field_name
            raise ValueError(f"a {what} {len(given)} {kind} is not one of 1 to {most}")
        return given


class JointMove(_Path):
    """Points to pass in joint space, shape (m, n) [rad or m], with rounded corners if ``blend`` > 0."""

    kind: Literal["joint"] = "joint"
    points: Annotated[NDArray[np.float64], _rows(list[list[float]])]
    blend: Annotated[float, Field(ge=0, le=LARGEST, description=f"a finite number >= 0 [rad or m]{_BOUND}")] = 0.0


Poses = list[Annotated[list[float], AfterValidator(unit_pose)]]
"""x, y, z, qx, qy, qz, qw of each, with quaternions of length 1."""


class LineMove(_Path):
    """Straight lines or arcs of a wrist; of two wrists the first, and the second beside it.

    Attributes:
        poses: Of the wrist in ``world``; of an arc two each, of which the first gives its place alone.
        points: In place of the poses: positions of the joints that move the first of two wrists, straight from each to
            the next, shape (m, n) [rad or m].
        relative: Poses of the second wrist in the first, at each end of a leg; None: it keeps the one it has. With
            neither poses nor points the first wrist stands still.
        arc: Whether the poses are those of arcs.
        speed: Of the wrist [m/s], and of the second in the first; 0: as fast as limits allow.
        blend: [m]; 0: at rest in every pose.
    """

    kind: Literal["line"] = "line"
    poses: Poses | None = None
    points: Annotated[NDArray[np.float64], _rows(list[list[float]])] | None = None
    relative: Poses | None = None
    arc: bool = False
    speed: Annotated[float, Field(ge=0, le=LARGEST, description=f"a finite number >= 0 [m/s]{_BOUND}")] = 0.0
    blend: Metres = 0.0

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.poses is None and self.points is None and self.relative is None:
            raise ValueError("a line has poses, points or relative poses")
        if self.poses is not None and self.points is not None:
            raise ValueError("a line has poses or points, not both")
        if self.arc and (self.poses is None or len(self.poses) % self.poses_a_leg):
            given = 0 if self.poses is None else len(self.poses)
            raise ValueError(f"arcs need two poses each, one on the way and one at the end; {given} are given")
        if self.relative is not None and self.ends not in (0, len(self.relative)):
            raise ValueError(f"{len(self.relative)} relative poses are given for {self.ends} ends of the first wrist")
        return self

    @property
    def poses_a_leg(self) -> int:
        """Number of poses that are given for each leg."""
        return 2 if self.arc else 1

    @property
    def ends(self) -> int:
        """How many ends the motion of the first wrist has; 0: it stands still."""
        if self.points is not None:
            return len(self.points)
        return 0 if self.poses is None else len(self.poses) // self.poses_a_leg


def _points(given: object, info: ValidationInfo) -> TimedPoints:
    points = unpack_points(given)
    times, most = points.times, (info.context or {}).get("max_trajectory_points")
    if not 1 <= len(times) <= (len(times) if most is None else most):
        raise ValueError(f"a trajectory of {len(times)} points is not one of 1 to {most}")
    late = np.flatnonzero(~(np.diff(times) > 0.0))
    if late.size:
        k = int(late[0])
        raise ValueError(
            f"times must increase: point {k + 2} is at {times[k + 1]:g} s, not after point {k + 1} at {times[k]:g} s"
        )
    if not (times[0] >= 0.0 and times[-1] <= LARGEST):
        raise ValueError(f"times from {times[0]:g} to {times[-1]:g} s are not within 0 to {LARGEST:g} s")
    if points.a is not None and points.v is None:
        raise ValueError("the trajectory has accelerations but no velocities; give both, or velocities alone")
    return points


class TrajectoryMove(ServoRequest):
    """Positions at times, with the tolerances.

    Attributes:
        points: Positions at times; in a request as :func:`im_mcs.protocol.points.pack_points` writes them.
        path_tolerance: Bound of the error on the way, shape (n,) or empty; 0: not set, below 0: none.
        path_velocity_tolerance: The same of the velocity.
        goal_tolerance: Bound of the error at the end, shape (n,) or empty; 0: not set, below 0: none.
        goal_velocity_tolerance: The same of the velocity.
        goal_time_tolerance: Time allowed beyond the end to be within it [s]; 0: as long as settling may take.
        stream: It is followed at once, in its own time, and left with its last velocity until the next one comes.
        start_ns: Testbed time at which the times of a stream count from [ns]; 0: from its arrival on.
    """

    kind: Literal["trajectory"] = "trajectory"
    points: Annotated[TimedPoints, PlainValidator(_points)]
    path_tolerance: list[float] = Field(default_factory=list)
    path_velocity_tolerance: list[float] = Field(default_factory=list)
    goal_tolerance: list[float] = Field(default_factory=list)
    goal_velocity_tolerance: list[float] = Field(default_factory=list)
    goal_time_tolerance: Seconds = 0.0
    stream: bool = False
    start_ns: Annotated[int, Field(ge=0, description="a whole number >= 0 [ns]")] = 0


Move = JointMove | LineMove | TrajectoryMove
_PATHS: Mapping[str, type[ServoRequest]] = {"joint": JointMove, "line": LineMove, "trajectory": TrajectoryMove}


# requests


class Sender(ServoRequest):
    """Sender of a request: decides on the ownership of a group.

    Attributes:
        client: The process that asks, as :mod:`im_core.ros.peers.client_identity` knows it; empty: not known.
        names: What it goes by: its nodes, and an owner that the request names.
    """

    client: Text = ""
    names: Annotated[list[Text], Field(max_length=_MOST_NUMBERS, description="a list of texts")] = Field(
        default_factory=list
    )


NOBODY = Sender()
"""Who asks without saying who he is."""
By = Annotated[Sender, Field(description="client that asks, and its names")]


class ReserveRequest(ServoRequest):
    """Reserve the slots of a group for an owner, until a lease of testbed time lapses [s]; 0: never."""

    group: Text
    owner: Text = ""
    lease_s: Seconds = 0.0
    sender: By = NOBODY


class TakeOverRequest(ReserveRequest):
    """Take a group away from the owner: the motion ends on the path, and the group is reserved for a new owner."""


class ReleaseRequest(ServoRequest):
    """Take the slots of a group back."""

    group: Text
    sender: By = NOBODY


class RenewRequest(ServoRequest):
    """Let the leases of an owner run anew."""

    owner: Text


class RepartitionRequest(ServoRequest):
    """Divide the joints into the groups of another preset."""

    preset: Text
    sender: By = NOBODY


class TransitionRequest(ServoRequest):
    """Power on or off, enable or disable motion, by name: of a group, or of all groups of the sender."""

    group: Text = ""
    sender: By = NOBODY


class ResetRequest(ServoRequest):
    """End an emergency stop."""


def _share(scale: float) -> float:
    if scale != 0.0 and not SLOWEST <= scale <= 1.0:
        raise ValueError("out of range")
    return scale


class SettleBounds(ServoRequest):
    """When a group counts as at rest, as ``servo.settle`` of the configuration; 0 stands for the value there."""

    tolerance: Amount = 0.0
    still_tolerance: Amount = 0.0
    timeout_s: Amount = 0.0


class MoveRequest(ServoRequest):
    """Follow a path; a scale of 0 stands for 1.

    Attributes:
        until_force: Change of the force at a wrist that ends the motion as a success [N]; 0: it goes to its end.
    """

    group: Text
    path: Annotated[Move, Field(discriminator="kind")]
    policy: Annotated[Policy, Field(strict=False, description=f"one of {', '.join(Policy)}")] = Policy.REFUSE
    speed_scale: Annotated[float, Field(description=f"between {SLOWEST:g} and 1 (0 stands for 1)")] = 1.0
    until_force: Annotated[float, Field(ge=0, le=LARGEST, description=f"a finite number >= 0 [N]{_BOUND}")] = 0.0
    settle: SettleBounds = SettleBounds()
    sender: By = NOBODY

    @field_validator("speed_scale")
    @classmethod
    def _full(cls, scale: float) -> float:
        return _share(scale) or 1.0


class StreamRequest(ServoRequest):
    """The newest setpoint, torques or velocities of a group, good for the time of the lease.

    Attributes:
        velocities: One per joint; of a twist six, of the wrist: linear [m/s] and angular [rad/s].
        frame: Frame along whose axes a twist is.
    """

    group: Text
    kind: Annotated[
        Literal["setpoint", "torque", "jog", "twist"], Field(description="one of setpoint, torque, jog, twist")
    ]
    positions: Numbers = Field(default_factory=list)
    velocities: Numbers = Field(default_factory=list)
    frame: Text = ""
    torques: Numbers = Field(default_factory=list)
    lease_s: Annotated[
        float,
        Field(
            gt=0,
            le=LONGEST_LEASE_S,
            description=f"a number above 0 and up to {LONGEST_LEASE_S:g} [s], the time after which a silent sender "
            "is given up on",
        ),
    ]
    owner: Text = ""


class QueryRequest(ServoRequest):
    """Ask where the trajectory of a group is at a testbed time [ns]."""

    group: Text
    stamp_ns: Annotated[int, Field(ge=0, description="a whole number >= 0 [ns]")]


class CancelRequest(ServoRequest):
    """End a goal, by the number of the request."""

    goal: Annotated[int, Field(description="a whole number")]


class PauseRequest(ServoRequest):
    """Halt a group on the path; all groups without a name."""

    group: Text = ""


class ResumeRequest(ServoRequest):
    """Go on after a pause or a protective stop; all groups of the sender without a name."""

    group: Text = ""
    sender: By = NOBODY


class SetSpeedRequest(ServoRequest):
    """Set the share of the planned speed, for the current motion and later ones."""

    group: Text
    scale: Annotated[
        float, AfterValidator(_share), Field(description=f"a number from {SLOWEST:g} to 1, or 0, which halts")
    ]
    sender: By = NOBODY


class SetGripperRequest(ServoRequest):
    """Move jaws to an opening [m], with a force [N], 0: the gripper's largest; in place of the present motion."""

    gripper: Text
    opening: Annotated[float, Field(description="a number [m]")]
    force: Amount = 0.0
    replaces: bool = False
    sender: By = NOBODY


class SetControllerRequest(ServoRequest):
    """Let another control law, or the same with other parameters, take over a group; empty: the law in force."""

    group: Text
    controller: Text
    parameters: dict[str, Any] = Field(default_factory=dict)
    sender: By = NOBODY


class SetPayloadRequest(ServoRequest):
    """Set the load of a wrist of a group: mass [kg], centre [m], inertia about the centre [kg m2].

    Attributes:
        wrist: Its frame; empty: the group has one.
    """

    group: Text
    wrist: Text = ""
    mass: Amount
    center: Annotated[list[Finite], Field(min_length=3, max_length=3, description="3 finite numbers")]
    inertia: Annotated[
        list[Finite], Field(min_length=6, max_length=6, description="6 finite numbers (xx, xy, xz, yy, yz, zz)")
    ]
    sender: By = NOBODY


class CollisionSceneRequest(ServoRequest):
    """Set all free bodies that the collision watch keeps away from, and all allowed contacts."""

    things: Annotated[list[Thing], Field(max_length=_MOST_NUMBERS)] = Field(default_factory=list)
    contacts: Annotated[list[AllowedContact], Field(max_length=_MOST_NUMBERS)] = Field(default_factory=list)


class ProtectiveStopRequest(ServoRequest):
    """Decelerate on the paths and hold."""

    reason: Text


class EstopRequest(ServoRequest):
    """Stop at once."""

    reason: Text


REQUESTS: Mapping[str, type[ServoRequest]] = {
    "reserve": ReserveRequest,
    "take_over": TakeOverRequest,
    "release": ReleaseRequest,
    "renew": RenewRequest,
    "repartition": RepartitionRequest,
    "power_on": TransitionRequest,
    "power_off": TransitionRequest,
    "enable_motion": TransitionRequest,
    "disable_motion": TransitionRequest,
    "move": MoveRequest,
    "stream": StreamRequest,
    "query": QueryRequest,
    "cancel": CancelRequest,
    "pause": PauseRequest,
    "resume": ResumeRequest,
    "set_speed": SetSpeedRequest,
    "set_gripper": SetGripperRequest,
    "set_controller": SetControllerRequest,
    "set_payload": SetPayloadRequest,
    "surround": CollisionSceneRequest,
    "protective_stop": ProtectiveStopRequest,
    "estop": EstopRequest,
    "reset": ResetRequest,
}
"""The model of every request that the servo knows, by its name."""


def request_message(number: int, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return a request as JSON data; ``number`` comes back with the answer."""
    return {"id": number, "request": name, "arguments": arguments}


def request_id(message: Mapping[str, Any]) -> int:
    """Return the number of a request, 0 without one."""
    number = message.get("id", 0)
    return number if isinstance(number, int) else 0


def parse_request(message: Mapping[str, Any], max_points: int, max_trajectory_points: int) -> tuple[str, ServoRequest]:
    """Name and arguments of a request from JSON data.

    Args:
        message: The data.
        max_points: How many points a path may have, and
        max_trajectory_points: a trajectory.

    Raises:
        NotFoundError: The servo knows no such request.
        DataError: An argument is missing, too much, or not what it should be; it is named.
    """
    name = message.get("request")
    if not isinstance(name, str) or name not in REQUESTS:
        raise NotFoundError(kind="request", name=str(name), known=REQUESTS)
    model, given = REQUESTS[name], message.get("arguments", {})
    if not isinstance(given, dict):
        raise DataError(f"{name}: the arguments are not an object but {reprlib.repr(given)}", request=name)
    limits = {"max_points": max_points, "max_trajectory_points": max_trajectory_points}
    try:
        return name, model.model_validate(given, context=limits)
    except ValidationError as error:
        fault = faults(error, model)[0]
        raise DataError(_sentence(name, model, given, fault), request=name, argument=fault.field) from None


def _sentence(name: str, model: type[ServoRequest], given: Mapping[str, Any], fault: Fault) -> str:
    """Return the fault of a request as a sentence; a field with a description is named by the description."""
    where, value, here = fault.location, reprlib.repr(fault.value), model
    below: Any = given
    for rank, part in enumerate(where):
        if where[:rank] == ("path",):
            here = _PATHS[str(part)]
            continue
        if isinstance(part, str):
            if part not in here.model_fields or (fault.kind == "missing" and rank == len(where) - 1):
                return _fields(name, model, here, given, fault)
            if (what := here.model_fields[part].description) is not None:
                place = _place(where[:rank]) if rank > 0 else name
                return f"{place + ': ' if place else ''}{part} {reprlib.repr(below[part])} is not {what}"
        below = below[part]
    match fault.kind:
        case "union_tag_not_found" | "union_tag_invalid":
            return f"path: kind {reprlib.repr(below.get('kind'))} is not one of {', '.join(_PATHS)}"
        case "value_error":
            return f"{_place(where[:4]).partition(': ')[0]}: {fault.words}" if "poses" in where[:-1] else fault.words
        case "list_type":
            return f"{_place(where)}: {value} is not a list"
    if where == ("path",):
        return f"a path is an object with a kind, not {value}"
    return f"{_place(where)}: {value} is not a number"


def _fields(
    name: str, model: type[ServoRequest], here: type[ServoRequest], given: Mapping[str, Any], fault: Fault
) -> str:
    """Return missing or surplus fields, and the known ones."""
    needed = [field for field, info in here.model_fields.items() if info.is_required() or field == "kind"]
    order = [*needed, *(f"[{field}]" for field in here.model_fields if field not in needed)]
    if here is model:
        return f"{name} takes {', '.join(order) or 'no arguments'}, not {', '.join(sorted(given)) or 'none'}"
    _, kind, field = fault.location
    wrong = f"{field} is missing" if fault.kind == "missing" else f"unknown {field}"
    return f"path of kind {kind}: {wrong}; it takes {', '.join(order)}"


def _place(where: Location) -> str:
    """Return ``("path", "joint", "points", 0, 3)`` as ``point 1``."""
    words: list[str] = []
    for part in where[2:] if where[:1] == ("path",) else where:
        if isinstance(part, str):
            words.append(part)
        elif words[-1] == "points":
            words[-1] = f"point {part + 1}"
        elif words[-1] == "poses":
            words[-1] = f"pose {part + 1} of the line: the pose"
    return ": ".join(words)
