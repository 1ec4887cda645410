"""A path around an obstacle, as the Path Planning Coordinator gets it from its search, and as MCS checks it."""

import asyncio
import json
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell
from im_coordinators.ros.path_planning import planning_functions, wrist_pose
from im_coordinators.tool import WristPlacement
from im_core.config import package_file
from im_core.errors import ImError
from im_core.ros.messages.status import to_status
from im_mcs.client.kinematics import Kinematics
from im_mcs.limits.configuration import load_config
from im_mcs.model import CellModel
from im_msgs.msg import GroupState
from im_msgs.srv import CheckPath, GetGroupState, GetSurroundings, InverseKinematics
from im_pnt.netfile import load_net

CONFIG = load_config()
MODEL = CellModel(load_cell())
#: The left arm at home, and where its wrist would go through the block on the straight way.
TURNED = 1.8
NET = "nets/path_planning_coordinator.yaml"


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
            wrist = wrist_pose(wrist_of(self._cell, home))
            answer.state = GroupState(group=request.group, joints=joints, q=home, q_rest=home, wrist=wrist)
            return answer
        if service_type is InverseKinematics:
            p, o = request.wrist.position, request.wrist.orientation
            place, turn = (p.x, p.y, p.z), (o.x, o.y, o.z, o.w)
            try:
                q = self._kinematics.inverse(request.group, place, turn, request.seed, self._cell.home, True)
                answer.q = q.tolist()
            except ImError as error:
                answer.success, answer.status = False, to_status(error)
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
        defaults = load_net(package_file("im_coordinators", NET)).arguments_of("plan_path")
        self.request_arguments = defaults.check(arguments, "plan_path")
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


def test_a_tool_kept_upright_is_so_on_the_path_that_is_left(planning):
    cell, host, actions = planning
    goal = [-0.6, 0.0, 0.0, 1.4, 1.4, -2.6, 0.0, 0.0, 0.0]
    host.things = [block_at(_halfway(cell, goal))]
    home = list(cell.groups["left"].home)
    limit, leans = lean_of(cell, home) + 0.1, []
    for tilt in ({}, {"tilt": limit}):
        request = Request(group="left", joints=goal, **tilt)
        asyncio.run(actions["find_configuration"](request))
        asyncio.run(actions["plan_around"](request))
        points = [np.array(each) for each in (home, *(point.positions for point in host.dom["1/path"].points))]
        ways = [a + share * (b - a) for a, b in pairwise(points) for share in np.arange(0.0, 1.0, 0.01)]
        leans.append(max(lean_of(cell, q) for q in ways))
    assert leans[1] < limit < leans[0]
    tight = Request(group="left", joints=goal, tilt=0.1)
    asyncio.run(actions["find_configuration"](tight))
    with pytest.raises(ImError, match=r"the tool leans 18\.4 degrees from upright at the start of the path") as raised:
        asyncio.run(actions["plan_around"](tight))
    assert raised.value.code == "limit"


def test_a_region_is_reached_at_the_nearest_of_its_places_that_can_be(planning):
    cell, host, actions = planning
    x, y, z = tool_at(cell, list(cell.groups["left"].home))
    asked = {"group": "left", "position": [x + 0.3, y + 0.2, z - 0.1], "region": [0.4, 0.2, 0.1]}
    for action in ("plan_direct", "plan_around"):
        request = Request(**asked)
        asyncio.run(actions["find_configuration"](request))
        asyncio.run(actions[action](request))
        end = tool_at(cell, list(host.dom["1/path"].points[-1].positions))
        assert end == pytest.approx([x + 0.1, y + 0.1, z - 0.05], abs=1e-5)
    host.things = [block_at(end)]
    request = Request(**asked)
    asyncio.run(actions["find_configuration"](request))
    asyncio.run(actions["plan_around"](request))
    end = tool_at(cell, list(host.dom["1/path"].points[-1].positions))
    assert np.linalg.norm(end - np.array([x + 0.1, y + 0.1, z - 0.05])) > 0.05, "another place"
    assert (np.abs(np.subtract(end, asked["position"])) <= [0.2 + 1e-6, 0.1 + 1e-6, 0.05 + 1e-6]).all()
    with pytest.raises(ImError, match=r"nor at any place tried in the 0.1 x 0.1 x 0 m around it: left_wrist") as raised:
        asyncio.run(actions["find_configuration"](Request(**{**asked, "position": [9, 9, 9], "region": [0.1, 0.1, 0]})))
    assert raised.value.code == "unreachable"


def block_at(place):
    """A free body, as MCS tells it."""
    pose = [*place, 0.0, 0.0, 0.0, 1.0]
    return {"name": "block", "kind": "box", "size": [0.05, 0.05, 0.16], "frame": "world", "pose": pose}


def wrist_of(cell, q):
    """The placement of the left wrist."""
    whole = cell.home.copy()
    whole[:9] = q
    pose = pin.SE3ToXYZQUAT(MODEL.pose(whole, "left_wrist"))
    return WristPlacement.of(pose[:3], pose[3:])


def tool_at(cell, q):
    """Where the middle of the jaws is, shape (3,) [m]."""
    wrist = wrist_of(cell, q)
    return (wrist.position + wrist.rotation @ [0.0, 0.0, cell.reach_of("left")]).tolist()


def lean_of(cell, q):
    """Angle of the axis that is nearest to the vertical at home, the x axis upside down [rad]."""
    return np.arccos(-wrist_of(cell, q).rotation[2, 0])


def _halfway(cell, goal):
    """Where the hand is in the middle of the straight way to a goal, shape (3,) [m]."""
    model = CellModel(cell)
    data, q = model.pin.createData(), cell.home.copy()
    q[:9] = 0.5 * (q[:9] + np.array(goal))
    pin.framesForwardKinematics(model.pin, data, q)
    return data.oMf[model.frame_id("left_wrist")].act(np.array([0.0, 0.0, 0.1])).tolist()
