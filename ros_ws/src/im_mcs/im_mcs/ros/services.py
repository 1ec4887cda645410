"""Services of MCS: of the state manager, on motions under way, and kinematic questions."""

import json
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, Self, TypeVar

import numpy as np
import pydantic
from control_msgs.srv import QueryTrajectoryState
from numpy.typing import NDArray
from std_srvs.srv import Trigger

from im_core.config import FieldError, parse_model
from im_core.errors import DataError, ImError, NotFoundError, StateError
from im_core.ros.calls import run_in_thread
from im_core.ros.messages.status import ok_status, to_status
from im_mcs.client.groups import best_positions, group_state
from im_mcs.client.points import ordered_points
from im_mcs.collision import AllowedContact, Thing
from im_mcs.collision.surroundings import LONGEST_CONTACT_S
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.state import Event, State
from im_mcs.state.table import STATES
from im_msgs.msg import GroupState as GroupStateMessage
from im_msgs.srv import (
    AllowContact,
    CheckPath,
    ForwardKinematics,
    GetGroupState,
    GetSurroundings,
    GroupCommand,
    InverseKinematics,
    RenewLease,
    ReserveGroup,
    SetController,
    SetGripper,
    SetPartition,
    SetPayload,
    SetSpeed,
    SetThing,
)

_TRANSITIONS = (Event.POWER_ON, Event.POWER_OFF, Event.ENABLE_MOTION, Event.DISABLE_MOTION)
_WAY = (Event.RESERVE, Event.POWER_ON, Event.ENABLE_MOTION)
"""From cold to motion."""
_COVERED = {State.RESERVED: 1, State.ACTIVE: 2, State.MOTION: 3}
"""How much of the way a state has behind it."""
_STOPS = (Event.PROTECTIVE_STOP, Event.RESET)

Work = Callable[[Any, Any, str], Awaitable[str]]
"""What a service does: given request, response and client, it returns what to say."""

_Answer = TypeVar("_Answer")

_MOST_QUESTIONS = 16
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class LawParameters(pydantic.RootModel[dict[str, pydantic.JsonValue]]):
    """Parameters of a control law by name, as a request gives them."""

    @pydantic.model_validator(mode="after")
    def _check_finite(self) -> Self:
        for name, value in self.root.items():
            try:
                json.dumps(value, allow_nan=False)
            except ValueError:
                raise FieldError((name,), f"{value} has a number that is not finite") from None
        return self


class StateServices:
    """``/mcs/reserve``, ``take_over``, ``release``, ``renew``, ``set_partition``; a ``std_srvs/Trigger`` an event.

    What changes power and motion is there once more, for one group and with its owner: ``/mcs/group/power_on`` etc.
    ``/mcs/<group>/ready`` does all that a motion of a group needs.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        offer(access, ReserveGroup, "/mcs/reserve", self._reserve)
        offer(access, ReserveGroup, "/mcs/take_over", self._take_over)
        offer(access, ReserveGroup, "/mcs/release", self._release)
        offer(access, RenewLease, "/mcs/renew", self._renew)
        offer(access, SetPartition, "/mcs/set_partition", self._set_partition)
        for event in _TRANSITIONS:
            stops = event in (Event.POWER_OFF, Event.DISABLE_MOTION)
            offer(access, Trigger, f"/mcs/{event.value}", self._of_caller(event), urgent=stops)
            offer(access, GroupCommand, f"/mcs/group/{event.value}", self._of_group(event), urgent=stops)
        for event in _STOPS:
            offer(access, Trigger, f"/mcs/{event.value}", self._of_all(event), urgent=event is Event.PROTECTIVE_STOP)
        for group in access.group_names:
            offer(access, Trigger, f"/mcs/{group}/ready", self._ready(group))

    async def _reserve(self, request: ReserveGroup.Request, _: object, client: str) -> str:
        await self._mcs.recover()  # work begins here: what was lost since the last is looked for
        await self._mcs.request(Event.RESERVE, await self._reservation(request, client))
        return f"MCS is {self._mcs.state.value}"

    async def _take_over(self, request: ReserveGroup.Request, _: object, client: str) -> str:
        arguments = await self._reservation(request, client)
        results = await self._mcs.request(Event.TAKE_OVER, arguments)
        return self._mcs.take_overs.add(
            request.group, results["owner"], request.owner, arguments["sender"]["names"] or [client]
        )

    async def _release(self, request: ReserveGroup.Request, _: object, client: str) -> str:
        self._mcs.group(request.group)
        sender = await self._mcs.sender(client, request.owner)
        await self._mcs.request(Event.RELEASE, {"group": request.group, "sender": sender})
        return f"MCS is {self._mcs.state.value}"

    async def _reservation(self, request: ReserveGroup.Request, client: str) -> dict[str, Any]:
        self._mcs.group(request.group)
        sender = await self._mcs.sender(client)
        return {"group": request.group, "owner": request.owner, "lease_s": request.lease, "sender": sender}

    async def _renew(self, request: RenewLease.Request, *_: object) -> str:
        await self._mcs.request(Event.RENEW, {"owner": request.owner})
        return f"the lease of '{request.owner}' is renewed"

    async def _set_partition(self, request: SetPartition.Request, _: object, client: str) -> str:
        await self._mcs.repartition(request.preset, client)
        return f"the groups are {', '.join(self._mcs.config.groups)}"

    def _ready(self, group: str) -> Work:
        async def work(_: object, __: object, client: str) -> str:
            return await self.make_ready(group, client)

        return work

    async def make_ready(self, group: str, client: str) -> str:
        """Reserve a group, switch its power on and release its brakes, from whatever state; return what to say.

        Raises:
            ImError: A step is refused, or ended badly; those before it stay.
        """
        await self._mcs.recover()
        self._mcs.group(group)
        row = next(row for row in self._mcs.client().snapshot()["groups"] if messages.text(row["name"]) == group)
        state, owner = STATES[int(row["state"])], messages.text(row["owner"])
        sender = await self._mcs.sender(client)
        if state is State.MOTION and owner and owner not in sender["names"]:
            raise StateError(f"group '{group}' is in motion already, and its owner is '{owner}'", group=group)
        for event in _WAY[_COVERED.get(state, 0) :]:
            await self._mcs.request(event, {"group": group, "sender": sender})
        return f"group '{group}' is in motion: it may move"

    def _of_caller(self, event: Event) -> Work:
        async def work(_: object, __: object, client: str) -> str:
            return await self._mcs.transition(event, client)

        return work

    def _of_group(self, event: Event) -> Work:
        async def work(request: GroupCommand.Request, _: object, client: str) -> str:
            return await self._mcs.transition(event, client, request.group, request.owner)

        return work

    def _of_all(self, event: Event) -> Work:
        async def work(*_: object) -> str:
            return await self._mcs.stop(event)

        return work


class MotionServices:
    """``/mcs/pause``, ``resume``, ``set_speed``, ``set_payload``, ``set_controller`` and ``set_gripper``.

    ``/<group>/query_state`` of every group of every preset answers as that of ros2_control's trajectory controller.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        offer(access, GroupCommand, "/mcs/pause", self._pause, urgent=True)
        offer(access, GroupCommand, "/mcs/resume", self._resume)
        offer(access, SetSpeed, "/mcs/set_speed", self._set_speed)
        offer(access, SetPayload, "/mcs/set_payload", self._set_payload)
        offer(access, SetController, "/mcs/set_controller", self._set_controller)
        offer(access, SetGripper, "/mcs/set_gripper", self._set_gripper)
        for group in access.group_names:
            offer(access, QueryTrajectoryState, f"/{group}/query_state", partial(self._query_state, group))

    async def _pause(self, request: GroupCommand.Request, *_: object) -> str:
        """Anyone may: to stop is always allowed."""
        if request.group:
            self._mcs.group(request.group)
        await self._mcs.request(Event.PAUSE, {"group": request.group})
        return f"{request.group or 'every group'} pauses"

    async def _resume(self, request: GroupCommand.Request, _: object, client: str) -> str:
        if request.group:
            self._mcs.group(request.group)
        sender = await self._mcs.sender(client, request.owner)
        await self._mcs.request(Event.RESUME, {"group": request.group, "sender": sender})
        return f"{request.group or 'every group'} goes on"

    async def _set_speed(self, request: SetSpeed.Request, _: object, client: str) -> str:
        self._mcs.group(request.group)
        if request.scale == 0.0:
            raise DataError(f"{request.group} does not move at 0 of the planned speed; pause it (/mcs/pause)")
        arguments = {"group": request.group, "scale": request.scale, "sender": await self._mcs.sender(client)}
        await self._mcs.request(Event.SET_SPEED, arguments)
        return f"{request.group} moves at {request.scale:g} of the planned speed"

    async def _set_payload(self, request: SetPayload.Request, _: object, client: str) -> str:
        payload = request.payload
        self._mcs.group(request.group)
        arguments = {
            "group": request.group,
            "wrist": request.wrist,
            "mass": payload.m,
            "center": [payload.com.x, payload.com.y, payload.com.z],
            "inertia": [getattr(payload, name) for name in _INERTIA],
            "sender": await self._mcs.sender(client),
        }
        await self._mcs.request(Event.SET_PAYLOAD, arguments)
        return f"{request.wrist or request.group} carries {payload.m:g} kg"

    async def _set_controller(self, request: SetController.Request, _: object, client: str) -> str:
        parameters = parse_model(request.parameters or "{}", LawParameters, "parameters").root
        return await switch_law(self._mcs, request.group, request.controller, client, parameters)

    async def _set_gripper(self, request: SetGripper.Request, response: SetGripper.Response, client: str) -> str:
        opening = 0.0 if request.close else self._mcs.cell.gripper.stroke
        sender = await self._mcs.sender(client)
        arguments = {"gripper": request.gripper, "opening": opening, "force": request.force, "sender": sender}
        results = await self._mcs.request(Event.SET_GRIPPER, arguments)
        response.opening = float(results["opening"])
        return ""

    async def _query_state(
        self, group: str, request: QueryTrajectoryState.Request, response: QueryTrajectoryState.Response, _: str
    ) -> str:
        joints, time = self._mcs.group(group).joints, request.time
        arguments = {"group": group, "stamp_ns": time.sec * 1_000_000_000 + time.nanosec}
        results = await self._mcs.request(Event.QUERY, arguments)
        response.name = list(joints)
        response.position, response.velocity, response.acceleration = (results[name] for name in ("q", "v", "a"))
        return ""


class SurroundingsServices:
    """``/mcs/set_thing`` and ``allow_contact``: free bodies for the collision watch, contacts allowed for a time."""

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        cell = access.cell
        self._links = [*(capsule.link for capsule in cell.bodies), *(box.name for box in cell.obstacles)]
        self._frames = ["world", *(group.tip for group in cell.groups.values())]
        self._carriers = {group.tip: cell.tree.carrier(group.tip).parent for group in cell.groups.values()}
        self._shapes = {body.name: body for body in cell.objects}
        offer(access, SetThing, "/mcs/set_thing", self._set_thing)
        offer(access, AllowContact, "/mcs/allow_contact", self._allow_contact)

    async def _set_thing(self, request: SetThing.Request, *_: object) -> str:
        mcs, name = self._mcs, request.name
        snapshot = mcs.client().snapshot()
        around = mcs.around(int(snapshot["stamp_ns"]))
        if not request.frame:
            await mcs.surround(around.without(name))
            return f"'{name}' is gone"
        if request.frame not in self._frames:
            raise NotFoundError(kind="frame", name=request.frame, known=self._frames)
        if name in self._links:
            raise DataError(f"'{name}' is a part of the cell, not a free body", name=name)
        if request.keep:
            before = around.thing(name)
            pose = mcs.model.seen_from(best_positions(snapshot), before.frame, before.pose, request.frame)
            thing = before.model_copy(update={"frame": request.frame, "pose": pose})
        else:
            kind, size = request.kind, tuple(map(float, request.size))
            if not kind:
                if name not in self._shapes:
                    raise NotFoundError(kind="object", name=name, known=self._shapes)
                kind, size = self._shapes[name].kind, self._shapes[name].size
            p, o = request.pose.position, request.pose.orientation
            thing = Thing.checked(name, kind, size, request.frame, (p.x, p.y, p.z, o.x, o.y, o.z, o.w))
        await mcs.surround(around.with_thing(thing))
        return f"'{name}' is in {request.frame}"

    async def _allow_contact(self, request: AllowContact.Request, *_: object) -> str:
        mcs, lease_s = self._mcs, request.lease
        first, second = (self._carriers.get(name, name) for name in (request.first, request.second))
        if not 0.0 <= lease_s <= LONGEST_CONTACT_S:
            text = f"lease {lease_s:g} s of a contact is not between 0 and {LONGEST_CONTACT_S:g}"
            raise DataError(text, argument="lease", value=lease_s)
        stamp_ns = int(mcs.client().snapshot()["stamp_ns"])
        around = mcs.around(stamp_ns)
        known = [*dict.fromkeys(self._links), *(thing.name for thing in around.things)]
        for name in (first, second):
            if name not in known:
                raise NotFoundError(kind="object or link", name=name, known=known)
        contact = AllowedContact(first=first, second=second, until_ns=stamp_ns + round(lease_s * 1e9))
        await mcs.surround(around.with_contact(contact).at(stamp_ns))
        return f"'{first}' and '{second}' may touch for {lease_s:g} s"


class KinematicsServices:
    """``/mcs/get_group_state``, ``get_surroundings``, ``check_path``, and forward and inverse kinematics."""

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        self._asked = 0
        offer(access, GetGroupState, "/mcs/get_group_state", self._get_group_state)
        offer(access, ForwardKinematics, "/mcs/forward_kinematics", self._forward_kinematics)
        offer(access, InverseKinematics, "/mcs/inverse_kinematics", self._inverse_kinematics)
        offer(access, CheckPath, "/mcs/check_path", self._check_path)
        offer(access, GetSurroundings, "/mcs/get_surroundings", self._get_surroundings)

    def measured(self, group: str) -> GroupStateMessage:
        """Measured state of a group.

        Raises:
            StateError: MCS is unconfigured, or the group is one of another preset.
            NotFoundError: No such group.
        """
        mcs = self._mcs
        description, snapshot = mcs.group(group), mcs.client().snapshot()
        return messages.group_state(group_state(group, description, mcs.model, snapshot, mcs.config.servo.period_s))

    async def _get_group_state(self, request: GetGroupState.Request, response: GetGroupState.Response, _: str) -> str:
        response.state = self.measured(request.group)
        return ""

    async def _forward_kinematics(
        self, request: ForwardKinematics.Request, response: ForwardKinematics.Response, _: str
    ) -> str:
        mcs = self._mcs
        mcs.group(request.group)
        wrist = await self._ask(mcs.kinematics.forward, request.group, list(request.q), self._q_all())
        response.wrist = messages.pose(wrist.pose)
        return ""

    async def _inverse_kinematics(
        self, request: InverseKinematics.Request, response: InverseKinematics.Response, _: str
    ) -> str:
        mcs, p, o = self._mcs, request.wrist.position, request.wrist.orientation
        mcs.group(request.group)
        q = await self._ask(
            mcs.kinematics.inverse,
            request.group,
            (p.x, p.y, p.z),
            (o.x, o.y, o.z, o.w),
            list(request.seed),
            self._q_all(),
            request.avoid_collisions,
        )
        response.q = q.tolist()
        return ""

    async def _check_path(self, request: CheckPath.Request, response: CheckPath.Response, _: str) -> str:
        mcs = self._mcs
        points = ordered_points(
            request.group,
            mcs.group(request.group).joints,
            list(request.path.joint_names),
            [list(point.positions) for point in request.path.points],
        )
        check = mcs.kinematics.check_path
        response.clearance = await self._ask(check, request.group, points, self._q_all(), request.blend)
        return ""

    def _q_all(self) -> NDArray[np.float64]:
        snapshot = self._mcs.client().snapshot()
        self._mcs.around(int(snapshot["stamp_ns"]))  # contacts whose lease has ended are checked again
        return best_positions(snapshot)

    async def _get_surroundings(
        self, request: GetSurroundings.Request, response: GetSurroundings.Response, _: str
    ) -> str:
        mcs = self._mcs
        mcs.group(request.group)
        around = mcs.around(int(mcs.client().snapshot()["stamp_ns"]))
        lower, upper = mcs.kinematics.limits_of(request.group)
        response.clearance = mcs.config.collision.clearance_m
        response.lower, response.upper = lower.tolist(), upper.tolist()
        response.things_json = json.dumps([thing.model_dump() for thing in around.things])
        response.contacts = [name for contact in around.contacts for name in (contact.first, contact.second)]
        return ""

    async def _ask(self, question: Callable[..., _Answer], *arguments: object) -> _Answer:
        """Answer a question in a thread; only a few may wait at a time, since waiting questions slow the loop down.

        Raises:
            ImError: There are too many already, or there is no answer.
        """
        if self._asked >= _MOST_QUESTIONS:
            raise StateError(f"{self._asked} kinematic questions wait already, {_MOST_QUESTIONS} may; ask again later")
        self._asked += 1
        try:
            return await run_in_thread(self._mcs.node, question, *arguments)
        finally:
            self._asked -= 1


async def switch_law(
    mcs: McsAccess, group: str, law: str, client: str, parameters: Mapping[str, Any] | None = None
) -> str:
    """Let another control law, or one with other parameters, take over a group; return what to say.

    Raises:
        ImError: It is refused.
    """
    mcs.group(group)
    sender = await mcs.sender(client)
    arguments = {"group": group, "controller": law, "parameters": parameters or {}, "sender": sender}
    await mcs.request(Event.SET_CONTROLLER, arguments)
    return f"{law or 'the law in force'} takes over {group}"


def offer(mcs: McsAccess, srv_type: type[Any], name: str, work: Work, *, urgent: bool = False) -> None:
    """Offer a service with the outcome of ``work`` as the answer, or the reason of a failure.

    What is asked is looked at for its size before anything else.

    Args:
        mcs: MCS.
        srv_type: With ``success`` or ``ok``, and ``message`` or ``status``, in its answer; a list may have none.
        name: Of the service.
        work: Given request, response and the client that asks; it may fill what else the response has.
        urgent: Whether it stops something: its requests are taken before others that wait.
    """

    def serve(request: Any, response: Any) -> Callable[[str], Any]:
        async def answer(client: str) -> Any:
            try:
                mcs.check(request)
                said, error = await work(request, response, client), None
            except ImError as refused:
                said, error = refused.message, refused
            told = {
                "success": error is None,
                "ok": error is None,
                "status": ok_status(said) if error is None else to_status(error),
                "message": said,
            }
            for field in told.keys() & response.get_fields_and_field_types():
                setattr(response, field, told[field])
            return response

        return answer

    mcs.node.create_service(srv_type, name, serve, urgent=urgent)
