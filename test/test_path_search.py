"""A path around an obstacle, as the Path Planning Coordinator gets it from its search, and as MCS checks it."""

import asyncio
import json

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell
from im_coordinators.ros.path_planning import planning_functions
from im_core.errors import ImError
from im_core.ros.messages.status import to_status
from im_mcs.client.kinematics import Kinematics
from im_mcs.limits.configuration import load_config
from im_mcs.model import CellModel
from im_msgs.msg import GroupState
from im_msgs.srv import CheckPath, GetGroupState, GetSurroundings

CONFIG = load_config()
#: The left arm at home, and where its wrist would go through the block on the straight way.
TURNED = 1.8


class Store(dict):
    """The objects of a DOM."""

    async def put(self, name, message, place=""):
        self[name] = message


class Mcs:
    """Services of /mcs that planning asks, over its own kinematics; other things are done at once."""

    def __init__(self, cell):
        self.dom, self.things = Store(), []
        self._cell, model = cell, CellModel(cell)
        self._kinematics = Kinematics(CONFIG, model)

    async def ask(self, service_type, service, request, task, what):
        answer = service_type.Response(success=True)
        joints = [name for name in self._cell.joint_names if name.startswith(request.group)]
        if service_type is GetGroupState:
            home = list(self._cell.groups[request.group].home)
            answer.state = GroupState(group=request.group, joints=joints, q=home, q_rest=home)
            return answer
        if service_type is GetSurroundings:
            answer.clearance = CONFIG.collision.clearance_m
            lower, upper = self._kinematics.limits_of(request.group)
            answer.lower, answer.upper = lower.tolist(), upper.tolist()
            answer.things_json = json.dumps(self.things)
            return answer
        assert service_type is CheckPath
        points = [list(point.positions) for point in request.path.points]
        try:
            self._kinematics.check_path(request.group, points, self._cell.home)
        except ImError as error:
            answer.success, answer.status = False, to_status(error)
        return answer

    async def noted_apart(self, key, compute, *arguments):
        return compute(*arguments)


class Request:
    """The context of an action of a request."""

    def __init__(self, **arguments):
        defaults = {"destination": "", "position": [], "orientation": [], "frame": "world", "near": "here"}
        self.request_arguments = {**defaults, "leaves": "path", **arguments}
        self.memory = {}

    def object(self, name):
        return f"1/{name}"


@pytest.fixture
def planning(monkeypatch, tmp_path):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    cell = load_cell()
    host = Mcs(cell)
    return cell, host, planning_functions(host).actions


def goal_of(cell):
    goal = list(cell.groups["left"].home)
    goal[3] += TURNED
    return goal


def test_what_is_searched_passes_the_check_of_mcs_and_keeps_away_from_things(planning):
    cell, host, actions = planning
    goal = goal_of(cell)
    for host.things, points in (([], 1), ([block_at(_halfway(cell, goal))], 2)):
        request = Request(group="left", joints=goal)
        asyncio.run(actions["find_configuration"](request))
        asyncio.run(actions["plan_around"](request))
        path = host.dom["1/path"]
        assert path.joint_names == [name for name in cell.joint_names if name.startswith("left")]
        assert list(path.points[-1].positions) == pytest.approx(goal)
        assert len(path.points) >= points


def test_no_path_is_a_sentence(planning):
    cell, host, actions = planning
    goal = goal_of(cell)
    host.things = [block_at(_halfway(cell, [*goal[:3], goal[3] + TURNED, *goal[4:]]))]
    request = Request(group="left", joints=goal)
    asyncio.run(actions["find_configuration"](request))
    with pytest.raises(ImError, match="the goal of the path is too close to something") as raised:
        asyncio.run(actions["plan_around"](request))
    assert raised.value.code == "collision"


def block_at(place):
    """A free body, as MCS tells it."""
    pose = [*place, 0.0, 0.0, 0.0, 1.0]
    return {"name": "block", "kind": "box", "size": [0.05, 0.05, 0.16], "frame": "world", "pose": pose}


def _halfway(cell, goal):
    """Where the hand is in the middle of the straight way to a goal, shape (3,) [m]."""
    model = CellModel(cell)
    data, q = model.pin.createData(), cell.home.copy()
    q[:9] = 0.5 * (q[:9] + np.array(goal))
    pin.framesForwardKinematics(model.pin, data, q)
    return data.oMf[model.frame_id("left_wrist")].act(np.array([0.0, 0.0, 0.1])).tolist()
