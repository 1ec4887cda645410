"""Node ``/path_planning_coordinator``."""

import sys
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_coordinators.ros.carrier import carrier
from im_coordinators.strategies import DETOUR_FAILURES, detour
from im_core.config import package_file
from im_core.robot import load_cell
from im_core.ros import run
from im_core.ros.status import status_to_error
from im_msgs.msg import GroupState
from im_msgs.srv import CheckPath, GetGroupState, InverseKinematics
from im_pnt.again import again
from im_pnt.doubt import Answer, Verdict
from im_pnt.functions import woken_by
from im_pnt.ros.node import PntNode

CART_JOINTS = 3
ANSWER_S = 10.0


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
                "detour_may_help": woken_by()(lambda ctx: ctx.failure.code in DETOUR_FAILURES),
                "another_may_help": woken_by()(
                    lambda ctx: ctx.failure.code in DETOUR_FAILURES and "another" not in ctx.memory
                ),
            },
            asks={**{name: again(function) for name, function in functions.items()}, "check_given": self.given_checked},
        )
        self._tucked = {name: list(side.home) for name, side in load_cell().sides.items()}
        self._state = self.create_client(GetGroupState, "/mcs/get_group_state")
        self._kinematics = self.create_client(InverseKinematics, "/mcs/inverse_kinematics")
        self._check = self.create_client(CheckPath, "/mcs/check_path")

    async def find_configuration(self, ctx: Any) -> None:
        """Finds joint positions for the destination in the DOM, near to where the group is."""
        here = await self._here()
        await self._find(here, _position(here))

    async def find_another(self, ctx: Any) -> None:
        """Finds other joint positions for the destination, near to where the arm is out of the way."""
        here = await self._here()
        ctx.memory["another"] = True
        await self._find(here, [*_position(here)[:CART_JOINTS], *self._tucked[here.group][CART_JOINTS:]])

    async def plan_direct(self, ctx: Any) -> None:
        """Stores the joint-interpolated path to the goal if it is free."""
        here, goal = await self._here(), await self._goal()
        await self._store(here, [goal])

    async def plan_detour(self, ctx: Any) -> None:
        """Stores the path with the arm tucked on the way if it is free."""
        here, goal = await self._here(), await self._goal()
        await self._store(here, detour(_position(here), goal, self._tucked[here.group], CART_JOINTS))

    async def check_given(self, ctx: Any) -> None:
        """Stores the path that was given if it is free."""
        given = await self.dom.get("given_path", JointTrajectory)
        here = await self._here()
        await self._store(here, [list(point.positions) for point in given.points])
        await self.dom.invalidate("given_path")

    async def given_checked(self, ctx: Any) -> Answer:
        """What became of :meth:`check_given`: the given path is taken back when it has been stored as the path."""
        if not await self.dom.is_valid("given_path"):
            return Answer(Verdict.DONE, asked="/dom: the given path was used")
        return await again(self.check_given)(ctx)

    async def _here(self) -> GroupState:
        group = await carrier(self.dom)
        return (await self._ask(self._state, GetGroupState.Request(group=group), f"the position of {group}")).state

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

    async def _ask(self, client: Any, request: Any, what: str) -> Any:
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
