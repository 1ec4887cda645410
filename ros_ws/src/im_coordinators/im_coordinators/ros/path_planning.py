"""Node ``/path_planning_coordinator``."""

import json
import sys
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import Pose, PoseStamped
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_cell.robot import load_cell
from im_cell.visit_order import BLOCKED_S, leg_times, visit_order
from im_coordinators.motion import DESTINATIONS, way_asked
from im_coordinators.path_planning import (
    BLOCKED,
    another_may_help,
    configuration,
    home_seed,
    neighbours,
    require_joints,
    search_may_help,
    tucked_seed,
)
from im_coordinators.path_search import search_apart
from im_coordinators.ros.coordinator import Coordinator
from im_coordinators.tool import ToolTarget, WristPlacement, require_position
from im_core.errors import ImError, StateError
from im_core.ros import run
from im_core.ros.messages.status import status_to_error
from im_msgs.msg import GroupState
from im_msgs.srv import CheckPath, GetGroupState, GetSurroundings, InverseKinematics
from im_pnt.execution.functions import ActionContext, Functions, idempotent, woken_by
from im_pnt_node.rerun.host import Host

STATE, KINEMATICS, CHECK = "/mcs/get_group_state", "/mcs/inverse_kinematics", "/mcs/check_path"
AROUND = "/mcs/get_surroundings"
SERVICES = {STATE: GetGroupState, KINEMATICS: InverseKinematics, CHECK: CheckPath, AROUND: GetSurroundings}


class PathPlanningCoordinator(Coordinator):
    """Runs ``nets/path_planning_coordinator.yaml``."""

    def __init__(self) -> None:
        super().__init__("path_planning_coordinator", planning_functions)
        for service, service_type in SERVICES.items():
            self.host.prepare(service_type, service)


def planning_functions(host: Host) -> Functions:
    """Return the functions and enabling functions of the net, for a node or a substitute."""
    planning = PathPlanningFunctions(host)
    functions = {
        "find_configuration": planning.find_configuration,
        "find_another": planning.find_another,
        "plan_direct": planning.plan_direct,
        "plan_around": planning.plan_around,
        "check_given": planning.check_given,
        "check_reach": planning.check_reach,
        "order_positions": planning.order_positions,
    }
    guards = {
        "search_may_help": woken_by()(lambda ctx: search_may_help(ctx.failure)),
        "another_may_help": woken_by()(
            lambda ctx: (
                not (ctx.request_arguments["joints"] or ctx.request_arguments["posture"])
                and another_may_help(ctx.failure, ctx.memory)
            )
        ),
    }
    return Functions(functions, guards, {name: idempotent(function) for name, function in functions.items()})


class PathPlanningFunctions:
    """Functions of ``nets/path_planning_coordinator.yaml``; the net decides the order."""

    def __init__(self, host: Host) -> None:
        self._host = host
        cell = load_cell()
        self._cell = cell
        self._home = {name: list(group.home) for name, group in cell.groups.items()}
        self._carriers = {name: len(cell.carriers_of(group.base)) for name, group in cell.groups.items()}

    async def find_configuration(self, ctx: ActionContext) -> None:
        """Find joint positions for the request, near the present position of the group, or near home."""
        here = await self._here(ctx)
        seed = _position(here)
        if ctx.request_arguments["near"] == "home":
            seed = home_seed(seed, self._home[here.group])
        await self._find(ctx, here, seed)

    async def find_another(self, ctx: ActionContext) -> None:
        """Find other joint positions for the destination, near a position with the arm out of the way."""
        here = await self._here(ctx)
        ctx.memory["another"] = True
        await self._find(ctx, here, tucked_seed(_position(here), self._home[here.group], self._carriers[here.group]))

    async def plan_direct(self, ctx: ActionContext) -> None:
        """Store the joint-interpolated path to the goal if the path is free."""
        joints, start, goals = _way(ctx)
        await self._store(ctx, joints, start, goals[:1], "plan_done")

    async def plan_around(self, ctx: ActionContext) -> None:
        """Store a path around obstacles, with the tool upright if asked; the same request gives the same path."""
        joints, start, goals = _way(ctx)
        group = str(ctx.request_arguments["group"])
        positions = dict(zip(joints, start, strict=True))
        for other in neighbours(self._cell.partitions, group, joints):
            there = (await self._ask(STATE, GetGroupState.Request(group=other), f"the position of {other}")).state
            positions |= dict(zip(there.joints, _position(there), strict=True))
        what = "what lies around to be told"
        around = await self._ask(AROUND, GetSurroundings.Request(group=group), what)
        question = {
            "joints": joints, "positions": positions, "goals": goals, "lower": list(around.lower),
            "upper": list(around.upper), "clearance": around.clearance, "things": json.loads(around.things_json),
            "contacts": list(zip(around.contacts[::2], around.contacts[1::2], strict=True)), "seed": 0,
            "tilt": ctx.request_arguments["tilt"], "wrist": self._cell.groups[group].tip,
        }  # fmt: skip
        points = await self._host.noted_apart("path", search_apart, question)
        await self._store(ctx, joints, start, points, "plan_done")

    async def check_given(self, ctx: ActionContext) -> None:
        """Store the given path if the path is free."""
        given = await self._host.dom.get(ctx.object(str(ctx.request_arguments["path"])), JointTrajectory)
        here = await self._here(ctx)
        require_joints(given.joint_names, here.joints, here.group)
        points = [list(point.positions) for point in given.points]
        await self._store(ctx, here.joints, _position(here), points, "check_done")

    async def _here(self, ctx: ActionContext) -> GroupState:
        group = str(ctx.request_arguments["group"])
        answer = await self._ask(STATE, GetGroupState.Request(group=group), f"the position of {group}")
        here: GroupState = answer.state
        return here

    async def check_reach(self, ctx: ActionContext) -> None:
        """Find joint positions with the tool at a place, and keep none."""
        here = await self._here(ctx)
        await self._for_tool(here, ToolTarget.asked(ctx.request_arguments), _position(here))

    async def order_positions(self, ctx: ActionContext) -> None:
        """Find an order of positions with little time of motion, along straight free ways if possible."""
        given = await self._host.dom.get(ctx.object(str(ctx.request_arguments["positions"])), JointTrajectory)
        here = await self._here(ctx)
        require_joints(given.joint_names, here.joints, here.group)
        places = [_position(here), *(list(point.positions) for point in given.points)]
        times, known = leg_times(self._cell, list(here.joints), places), set[frozenset[int]]()
        while True:
            order = await self._host.noted_apart("order", visit_order, times)
            if known.issuperset(legs := [frozenset(leg) for leg in pairwise(order)]):
                break
            for a, b in (sorted(leg) for leg in legs if leg not in known):
                path = _trajectory(here.joints, [places[a], places[b]])
                if not await self._is_free(CheckPath.Request(group=here.group, path=path)):
                    times[a, b] = times[b, a] = times[a, b] + BLOCKED_S
            known.update(legs)
        ctx.result["order"] = order[1:]

    async def _is_free(self, request: CheckPath.Request) -> bool:
        try:
            await self._ask(CHECK, request, "a path to be checked")
        except ImError as error:
            if error.code in BLOCKED:
                return False
            raise
        return True

    async def _find(self, ctx: ActionContext, here: GroupState, seed: Sequence[float]) -> None:
        asked = ctx.request_arguments
        way = way_asked(asked, DESTINATIONS, "plan_path")
        require_position(asked, way)
        match way:
            case "joints":
                goals = [configuration(asked["joints"], here.joints, here.group)]
            case "posture":
                goals = [self._home[here.group]]
            case "position":
                goals = await self._for_tool(here, ToolTarget.asked(asked), seed)
            case _:
                destination = await self._host.dom.get(ctx.object(str(asked["destination"])), PoseStamped)
                goals = [await self._configuration(here, destination.pose, seed)]
        ctx.memory["goals"] = [list(here.joints), _position(here), goals]

    async def _for_tool(self, here: GroupState, target: ToolTarget, seed: Sequence[float]) -> list[list[float]]:
        """Return joint positions with the tool at the target, one for each place of a region within reach."""
        found: list[list[float]] = []
        refused: list[ImError] = []
        for wrist in target.wrists(placement_of(here.wrist), self._cell.reach_of(here.group)):
            try:
                found.append(await self._configuration(here, wrist_pose(wrist), seed))
            except ImError as error:
                refused.append(error)
        if not found:
            why = next((error for error in refused if error.code in BLOCKED), refused[0])
            raise target.refusal(why) from why
        return found

    async def _configuration(self, here: GroupState, wrist: Pose, seed: Sequence[float]) -> list[float]:
        request = InverseKinematics.Request(group=here.group, wrist=wrist, seed=seed, avoid_collisions=True)
        return list((await self._ask(KINEMATICS, request, "inverse kinematics")).q)

    async def _store(
        self,
        ctx: ActionContext,
        joints: Sequence[str],
        start: Sequence[float],
        points: Sequence[Sequence[float]],
        place: str,
    ) -> None:
        whole, group = _trajectory(joints, [start, *points]), str(ctx.request_arguments["group"])
        await self._ask(CHECK, CheckPath.Request(group=group, path=whole), "a path to be checked")
        name, path = ctx.object(str(ctx.request_arguments["leaves"])), _trajectory(joints, points)
        await self._host.dom.put(name, path, place=f"path_planning_coordinator.{place}")

    async def _ask(self, service: str, request: object, what: str) -> Any:
        answer = await self._host.ask(SERVICES[service], service, request, "mcs", what)
        if not answer.success:
            raise status_to_error(answer.status)
        return answer


def _way(ctx: ActionContext) -> tuple[list[str], list[float], list[list[float]]]:
    """Return the joints, the present positions, and the positions found for the request, of which any will do.

    Raises:
        StateError: Nothing was found.
    """
    way: Any = ctx.memory.get("goals")
    if way is None:
        raise StateError("no configuration has been found for the request")
    joints, start, goals = way
    return joints, start, goals


def _position(state: GroupState) -> list[float]:
    return list(state.q_rest or state.q)


def placement_of(pose: Pose) -> WristPlacement:
    """Return a pose of a message as the placement of a wrist."""
    p, o = pose.position, pose.orientation
    return WristPlacement.of((p.x, p.y, p.z), (o.x, o.y, o.z, o.w))


def wrist_pose(wrist: WristPlacement) -> Pose:
    """Return the placement of a wrist as a message."""
    message = Pose()
    position, orientation = message.position, message.orientation
    position.x, position.y, position.z = map(float, wrist.position)
    orientation.x, orientation.y, orientation.z, orientation.w = wrist.quaternion
    return message


def _trajectory(joints: Sequence[str], points: Sequence[Sequence[float]]) -> JointTrajectory:
    return JointTrajectory(
        joint_names=list(joints), points=[JointTrajectoryPoint(positions=list(point)) for point in points]
    )


def main() -> None:
    """Run ``/path_planning_coordinator``."""
    sys.exit(run.main(PathPlanningCoordinator))


if __name__ == "__main__":
    main()
