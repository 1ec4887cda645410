"""Groups of joints: arms with grippers, reserved, powered and moved."""

import contextlib
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im.connection import PATIENCE_S, Connection
from im.errors import MachineError, UnreachableError, require
from im.geometry import Pose, require_pose
from im.messages import message_of, number_of
from im_msgs.action import Move
from im_msgs.srv import (
    GetGroupState,
    GroupCommand,
    InverseKinematics,
    RenewLease,
    ReserveGroup,
    SetGripper,
)

#: A lease [s] is renewed so many times before it lapses; in real time.
_RENEWALS = 6
#: A shorter one [s] would lapse between two renewals.
_SHORTEST_LEASE_S = 0.1


class Group:
    """Group of joints of the preset in force."""

    def __init__(self, connection: Connection, name: str) -> None:
        self.name = name
        self._connection = connection

    @property
    def state(self) -> Any:
        """Measured state, ``im_msgs/msg/GroupState``.

        Raises:
            MachineError: There is no such group, or it cannot be measured now.
        """
        return require(self._connection.call(GetGroupState, "/mcs/get_group_state", group=self.name)).state

    @property
    def joints(self) -> dict[str, float]:
        """Measured positions by joint [rad or m]."""
        state = self.state
        return dict(zip(state.joints, map(float, state.q), strict=True))

    @property
    def tool_pose(self) -> Pose:
        """Measured pose of the wrist frame in the world; the middle of the jaws is further along the z axis."""
        return Pose.of(self.state.wrist)

    @contextlib.contextmanager
    def reserved(self, lease: float = 0.0) -> Iterator["Arm"]:
        """Reserve the group for the client, with power on and brakes off; undo all at the end.

        Args:
            lease: Time after which the reservation lapses where this client dies [s]; 0: never.

        Raises:
            MachineError: The group is another owner's, a transition is refused, or the lease is too short.
        """
        lease = number_of("lease", lease)
        if lease and lease < _SHORTEST_LEASE_S:
            told = f"lease is {lease:g} s, neither 0 nor at least {_SHORTEST_LEASE_S} s"
            raise MachineError(told, "argument", {"field": "lease"})
        owner, stop = self._connection.name, threading.Event()
        with contextlib.ExitStack() as undo:
            self._told(ReserveGroup, "reserve", owner=owner, lease=lease)
            undo.callback(self._told, ReserveGroup, "release", owner=owner)
            if lease:
                renewals = threading.Thread(target=self._renew, args=(stop, owner, lease / _RENEWALS), daemon=True)
                renewals.start()
                undo.callback(renewals.join)
                undo.callback(stop.set)
            self._told(GroupCommand, "group/power_on", owner=owner)
            undo.callback(self._told, GroupCommand, "group/power_off", owner=owner)
            self._told(GroupCommand, "group/enable_motion", owner=owner)
            undo.callback(self._told, GroupCommand, "group/disable_motion", owner=owner)
            try:
                yield Arm(self._connection, self.name)
            except MachineError:
                with contextlib.suppress(MachineError):  # the first failure counts: after a stop all is undone already
                    undo.close()
                raise

    def _told(self, kind: Any, service: str, **fields: Any) -> None:
        require(self._connection.call(kind, f"/mcs/{service}", group=self.name, **fields), group=self.name)

    def _renew(self, stop: threading.Event, owner: str, period_s: float) -> None:
        while not stop.wait(period_s):
            with contextlib.suppress(MachineError):  # the next motion says that the lease has lapsed
                self._connection.call(RenewLease, "/mcs/renew", patience=period_s, owner=owner)


class Arm(Group):
    """Reserved group, with power on and brakes off; made by :meth:`Group.reserved`."""

    @property
    def gripper(self) -> "Gripper":
        """Gripper of the arm."""
        return Gripper(self._connection, f"{self.name}_gripper")

    def move_to(
        self,
        pose: Pose,
        straight: bool = False,
        speed_scale: float = 1.0,
        until_force: float = 0.0,
        via: Pose | None = None,
    ) -> None:
        """Move the wrist frame to a pose, and wait for rest; Ctrl-C stops the motion.

        Args:
            pose: Goal in the world.
            straight: Along a straight line of the wrist; else interpolated in the joints.
            speed_scale: 0.01 to 1 of the configured limits.
            until_force: Change of the force at the wrist that ends the motion on its way [N]; 0: none.
            via: Place on the way: along the arc that passes it. Its orientation does not count.

        Raises:
            MachineError: The pose is out of reach, or the motion failed or was refused, or met no such force.
            TypeError: A pose is none, such as a list of numbers.
        """
        for name, given in (("pose", pose), ("via", via or pose)):
            require_pose(name, given)
        goal = message_of(Move.Goal, speed_scale=speed_scale, until_force=until_force)
        wrist = pose.message(self.tool_pose)
        if straight or via is not None:
            goal.arc = via is not None
            goal.line = [wrist] if via is None else [via.message(self.tool_pose), wrist]
            self._move(goal)
            return
        answer = self._connection.call(
            InverseKinematics, "/mcs/inverse_kinematics", group=self.name, wrist=wrist, avoid_collisions=True
        )
        require(answer)
        goal.path = _path(self.state.joints, answer.q)
        self._move(goal)

    def move_joints(self, speed_scale: float = 1.0, **positions: float) -> None:
        """Move joints to positions, and wait for rest; other joints of the group stay. Ctrl-C stops the motion.

        Args:
            speed_scale: 0.01 to 1 of the configured limits.
            **positions: Position by joint [rad or m], such as ``elbow=0.3``.

        Raises:
            MachineError: There is no such joint, or none is given, or the motion failed or was refused.
        """
        present = self.joints
        known = ", ".join(present)
        if not positions:
            raise MachineError(f"move_joints of group {self.name} needs a position of one of {known}", "argument")
        if unknown := positions.keys() - present.keys():
            raise MachineError(f"group {self.name} has no joint {sorted(unknown)[0]}; there are {known}", "argument")
        goal = {**present, **{joint: number_of(joint, position) for joint, position in positions.items()}}
        path = _path(list(goal), list(goal.values()))
        self._move(message_of(Move.Goal, path=path, speed_scale=speed_scale))

    def _move(self, goal: Move.Goal) -> None:
        connection, name = self._connection, f"/{self.name}/move"
        action, lives = connection.action(Move, name), connection.living("/mcs")
        sent = connection.inside(lambda: action.send_goal_async(goal))
        handle = connection.result(sent, f"the acceptance of a goal of {name}", PATIENCE_S, lives)
        if not handle.accepted:
            raise MachineError(f"{name} did not accept the goal", "state", {"group": self.name})
        future = connection.inside(handle.get_result_async)

        def moves() -> None:
            lives()
            if not action.server_is_ready():
                raise UnreachableError(f"/mcs died before a motion of {self.name} had ended")

        what = f"the end of a motion of {self.name}"
        try:
            answer = connection.result(future, what, None, moves)
        except KeyboardInterrupt:
            connection.inside(handle.cancel_goal_async)
            with contextlib.suppress(MachineError):
                connection.result(future, what, 10.0, moves)
            raise
        if answer.status != GoalStatus.STATUS_SUCCEEDED or not answer.result.success:
            raise MachineError.of(answer.result.status)


class Gripper:
    """Gripper of an arm.

    Args:
        connection: Connection to the machine.
        name: Name of the gripper: the group's with ``_gripper``.
    """

    def __init__(self, connection: Connection, name: str) -> None:
        self.name = name
        self._connection = connection

    def close(self, force: float = 0.0) -> float:
        """Close the jaws, or grip an object; return the opening [m].

        Args:
            force: Force [N]; 0: as much as the gripper has.

        Raises:
            MachineError: The gripper refused, or failed.
        """
        return self._set(True, force)

    def open(self) -> float:
        """Open the jaws; return the opening [m].

        Raises:
            MachineError: The gripper refused, or failed.
        """
        return self._set(False, 0.0)

    def _set(self, close: bool, force: float) -> float:
        answer = self._connection.call(SetGripper, "/mcs/set_gripper", gripper=self.name, close=close, force=force)
        return float(require(answer, gripper=self.name).opening)


def _path(joints: Sequence[str], q: Sequence[float] | NDArray[np.float64]) -> JointTrajectory:
    point = JointTrajectoryPoint(positions=[float(value) for value in q])
    return JointTrajectory(joint_names=list(joints), points=[point])
