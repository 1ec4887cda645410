"""Node ``/motion_coordinator``."""

import sys

from trajectory_msgs.msg import JointTrajectory

from im_cell.robot import load_cell
from im_coordinators.motion import (
    DESTINATIONS,
    HOLDING_STATES,
    POWERED_STATES,
    depends_on_here,
    end_noted,
    note_end,
    planned_beforehand,
    require_rest,
    state_for,
    take_path,
    way_asked,
)
from im_coordinators.ros.coordinator import MCS_STATE, Coordinator
from im_coordinators.ros.establishment import Establishment
from im_coordinators.ros.path_planning import STATE, placement_of, wrist_pose
from im_coordinators.tool import DETAILS, ToolTarget, WristPlacement, require_planned
from im_core.ros import run
from im_core.ros.messages.status import status_to_error
from im_msgs.msg import McsState
from im_msgs.srv import GetGroupState
from im_pnt.execution.functions import ActionContext, ActionFunction, Functions, idempotent, woken_by
from im_pnt_node.rerun.host import Host

of_mcs = woken_by(f"topic:{MCS_STATE}")


class MotionCoordinator(Coordinator):
    """Runs ``nets/motion_coordinator.yaml``."""

    def __init__(self) -> None:
        super().__init__("motion_coordinator", motion_functions)
        self.host.prepare(GetGroupState, STATE)
        self.follow_mcs()


def motion_functions(host: Host) -> Functions:
    """Return the functions and enabling functions of the net, for a node or a substitute."""
    motion = MotionFunctions(host)
    actions: dict[str, ActionFunction] = {"note_held": motion.note_held, "take_path": motion.take_path}
    return Functions(
        {
            **actions,
            "group_and_owner": motion.group_and_owner,
            "to_reserve": motion.to_reserve,
            "while_reserved": motion.while_reserved,
            "destination_asked": destination_asked,
            "path_asked": path_asked,
            "path_to_follow": motion.path_to_follow,
            "straight_line": motion.straight_line,
            "store_position": motion.store_position,
        },
        {
            "group_held": of_mcs(lambda ctx: motion.state(ctx) in HOLDING_STATES),
            "group_powered": of_mcs(lambda ctx: motion.state(ctx) in POWERED_STATES),
            "group_in_motion": of_mcs(lambda ctx: motion.state(ctx) == "motion"),
            "planned_beforehand": woken_by()(lambda ctx: planned_beforehand(ctx.request_arguments, ctx.memory)),
        },
        {name: idempotent(action) for name, action in actions.items()},
    )


class MotionFunctions:
    """Functions of ``nets/motion_coordinator.yaml``; the net decides the order."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._cell = load_cell()
        self._powered = Establishment(host, "mcs", "powered")

    def group_and_owner(self, ctx: ActionContext) -> dict[str, object]:
        """Return the arm to move, and the present node as the only owner."""
        return {"group": _group(ctx), "owner": self._host.name}

    async def to_reserve(self, ctx: ActionContext) -> dict[str, object]:
        """Return arm and owner, and note slots and power, held from now on, as established for the command."""
        await self._powered.note(ctx, _group(ctx))
        return self.group_and_owner(ctx)

    async def note_held(self, ctx: ActionContext) -> None:
        """Note the held slots and power as established in the present incarnation of MCS.

        Another may have been noted when it was reserved: an incarnation is heard of later than it gives its first
        answers.
        """
        await self._powered.note(ctx, _group(ctx))

    def take_path(self, ctx: ActionContext) -> None:
        """Take the path planned beforehand."""
        take_path(ctx.memory)

    async def while_reserved(self, ctx: ActionContext) -> dict[str, object]:
        """Return arm and owner, for slots and power reserved in the present incarnation of MCS."""
        await self._powered.require(ctx, _group(ctx))
        return self.group_and_owner(ctx)

    async def path_to_follow(self, ctx: ActionContext) -> dict[str, object]:
        """Return the goal of a move: the path of the command, for an arm without a loss of power since."""
        await self._powered.require(ctx, _group(ctx))
        path = await self._host.dom.get(ctx.object(_path(ctx)), JointTrajectory)
        if depends_on_here(ctx.request_arguments) and path.points:
            note_end(ctx.memory, path.points[-1].positions)
        return {"path": path}

    async def straight_line(self, ctx: ActionContext) -> dict[str, object]:
        """Return the goal of a straight move: the pose of the wrist at the end, the same one after a doubt."""
        group = _group(ctx)
        require_planned(ctx.request_arguments, "straight")
        await self._powered.require(ctx, group)
        if (end := end_noted(ctx.memory)) is None:
            asked = GetGroupState.Request(group=group)
            answer = await self._host.ask(GetGroupState, STATE, asked, "mcs", f"the position of {group}")
            if not answer.success:
                raise status_to_error(answer.status)
            target = ToolTarget.asked(ctx.request_arguments)
            wrist = target.wrist(placement_of(answer.state.wrist), self._cell.reach_of(group))
            end = [*wrist.position.tolist(), *wrist.quaternion]
            note_end(ctx.memory, end)
        return {"line": [wrist_pose(WristPlacement.of(end[:3], end[3:]))]}

    async def store_position(self, ctx: ActionContext, answer: GetGroupState.Response) -> None:
        """Store the position measured by MCS at rest, at the end of the command's move."""
        await self._powered.require(ctx, _group(ctx))
        told: McsState | None = self._host.last(MCS_STATE)
        require_rest(answer.state.group, answer.state.at_rest, told.reason if told else "")
        name = ctx.object(str(ctx.request_arguments["position"]))
        await self._host.dom.put(name, answer.state, place="motion_coordinator.pos_found")

    def state(self, ctx: ActionContext) -> str:
        """Return the state of the arm to move, as far as the present node may move the arm."""
        told: McsState | None = self._host.last(MCS_STATE)
        return state_for([] if told is None else told.groups, _group(ctx), self._host.name)


def destination_asked(ctx: ActionContext) -> dict[str, object]:
    """Return the destination of the arm from the request's arguments; after a start, the end of the path followed."""
    asked = ctx.request_arguments
    way = way_asked(asked, (*DESTINATIONS, "path"), "move_robot")
    here = {"group": asked["group"], "near": asked["near"], "tilt": asked["tilt"], "leaves": _path(ctx)}
    if (end := end_noted(ctx.memory)) is not None:
        return {**here, "joints": end}
    return {**here, way: asked[way], **{name: asked[name] for name in DETAILS}}


def path_asked(ctx: ActionContext) -> dict[str, object]:
    """Along which path the arm is to move."""
    asked = ctx.request_arguments
    way_asked(asked, (*DESTINATIONS, "path"), "move_robot")
    require_planned(asked, "path")
    return {"group": asked["group"], "path": asked["path"], "leaves": _path(ctx)}


def _group(ctx: ActionContext) -> str:
    return str(ctx.request_arguments["group"])


def _path(ctx: ActionContext) -> str:
    """Return the name of the path to follow: two arms of one command follow two paths."""
    return f"path/{_group(ctx)}"


def main() -> None:
    """Run ``/motion_coordinator``."""
    sys.exit(run.main(MotionCoordinator))


if __name__ == "__main__":
    main()
