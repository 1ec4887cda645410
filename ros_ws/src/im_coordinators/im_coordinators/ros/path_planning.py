"""Node ``/path_planning_coordinator``."""

import sys
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.client import Client
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_cell.robot import load_cell
from im_coordinators.path_planning import another_may_help, detour, detour_may_help, tucked_seed
from im_coordinators.ros.calibration import group_of
from im_core.config import package_file
from im_core.ros import run
from im_core.ros.status import status_to_error
from im_msgs.msg import GroupState
from im_msgs.srv import CheckPath, GetGroupState, InverseKinematics
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.functions import ActionContext, idempotent, woken_by
from im_pnt.ros.node import PntNode
from im_pnt_analysis import verify_to_load

ANSWER_S = 30.0


class PathPlanningCoordinator(PntNode):
    """Functions of ``nets/path_planning_coordinator.yaml``; the net decides what comes when."""

    def __init__(self) -> None:
        functions = {
            "find_configuration": self.find_configuration,
            "find_another": self.find_another,
            "plan_direct": self.plan_direct,
            "plan_detour": self.plan_detour,
            "check_given": self.check_given,
        }
        super().__init__(
            "path_planning_coordinator",
            [package_file("im_coordinators", "nets/path_planning_coordinator.yaml")],
            functions=functions,
            guards={
                "detour_may_help": woken_by()(lambda ctx: detour_may_help(ctx.failure)),
                "another_may_help": woken_by()(lambda ctx: another_may_help(ctx.failure, ctx.memory)),
            },
            asks={
                **{name: idempotent(function) for name, function in functions.items()},
                "check_given": self.given_checked,
            },
            verifier=verify_to_load,
        )
        self._tucked = {name: list(side.home) for name, side in load_cell().sides.items()}
        self._state = self.create_client(GetGroupState, "/mcs/get_group_state")
        self._kinematics = self.create_client(InverseKinematics, "/mcs/inverse_kinematics")
        self._check = self.create_client(CheckPath, "/mcs/check_path")

    async def find_configuration(self, ctx: ActionContext) -> None:
        """Finds joint positions for the destination in the DOM, near to where the group is."""
        here = await self._here(ctx)
        await self._find(here, _position(here))

    async def find_another(self, ctx: ActionContext) -> None:
        """Finds other joint positions for the destination, near to where the arm is out of the way."""
        here = await self._here(ctx)
        ctx.memory["another"] = True
        await self._find(here, tucked_seed(_position(here), self._tucked[here.group]))

    async def plan_direct(self, ctx: ActionContext) -> None:
        """Stores the joint-interpolated path to the goal if it is free."""
        here, goal = await self._here(ctx), await self._goal()
        await self._store(here, [goal])

    async def plan_detour(self, ctx: ActionContext) -> None:
        """Stores the path with the arm tucked on the way if it is free."""
        here, goal = await self._here(ctx), await self._goal()
        await self._store(here, detour(_position(here), goal, self._tucked[here.group]))

    async def check_given(self, ctx: ActionContext) -> None:
        """Stores the path that was given if it is free."""
        given = await self.dom.get("given_path", JointTrajectory)
        here = await self._here(ctx)
        await self._store(here, [list(point.positions) for point in given.points])
        await self.dom.invalidate("given_path")

    async def given_checked(self, ctx: ActionContext) -> Answer:
        """What became of :meth:`check_given`: the given path is taken back when it has been stored as the path."""
        if not await self.dom.is_valid("given_path"):
            return Answer(Outcome.DONE, asked="/dom: the given path was used")
        asked = idempotent(self.check_given)(ctx)
        return asked if isinstance(asked, Answer) else await asked

    async def _here(self, ctx: ActionContext) -> GroupState:
        group = await group_of(ctx, self.dom)
        answer = await self._ask(self._state, GetGroupState.Request(group=group), f"the position of {group}")
        here: GroupState = answer.state
        return here

    async def _find(self, here: GroupState, seed: Sequence[float]) -> None:
        destination = await self.dom.get("destination", PoseStamped)
        request = InverseKinematics.Request(group=here.group, wrist=destination.pose, seed=seed, avoid_collisions=True)
        answer = await self._ask(self._kinematics, request, "inverse kinematics")
        goal = _trajectory(here.joints, [answer.q])
        await self.dom.put("goal_configuration", goal, place="path_planning_coordinator.goal_valid")

    async def _goal(self) -> list[float]:
        goal = await self.dom.get("goal_configuration", JointTrajectory)
        return list(goal.points[-1].positions)

    async def _store(self, here: GroupState, points: Sequence[Sequence[float]]) -> None:
        whole = _trajectory(here.joints, [_position(here), *points])
        await self._ask(self._check, CheckPath.Request(group=here.group, path=whole), "a path to be checked")
        await self.dom.put("path", _trajectory(here.joints, points), place="motion_coordinator.path_valid")

    async def _ask(self, client: Client, request: object, what: str) -> Any:
        answer = await self.heartbeats.wait(client.call_async(request), "mcs", ANSWER_S, what)
        if not answer.success:
            raise status_to_error(answer.status)
        return answer


def _position(state: GroupState) -> list[float]:
    return list(state.q_rest or state.q)


def _trajectory(joints: Sequence[str], points: Sequence[Sequence[float]]) -> JointTrajectory:
    return JointTrajectory(
        joint_names=list(joints), points=[JointTrajectoryPoint(positions=list(point)) for point in points]
    )


def main() -> None:
    """Run ``/path_planning_coordinator``."""
    sys.exit(run.main(PathPlanningCoordinator))


if __name__ == "__main__":
    main()
