"""What MoveIt is told of the cell, against the robot description, MCS and the servers that there are."""

import re
import xml.etree.ElementTree as ET
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory

from im_cell.robot import load_cell, robot_description
from im_mcs.collision import Bodies
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

CELL, CONFIG = load_cell(), load_config()
LIMITS = JointLimits(CELL, CONFIG.limits, CONFIG.slots).enforced()
URDF = robot_description(CELL, LIMITS)
ROBOT = ET.fromstring(URDF)
MOVEIT = Path(get_package_share_directory("im_bringup")) / "moveit"
SRDF = (MOVEIT / "cell.srdf").read_text()
SEMANTICS = ET.fromstring(SRDF)
LINKS = [link.get("name") for link in ROBOT.findall("link")]
JOINTS = {joint.get("name"): joint for joint in ROBOT.findall("joint")}
ACTIONS = dict(
    re.findall(r"\| `(/\S+)` \| `(\S+)` \|", (Path(__file__).parents[4] / "docs" / "interfaces.md").read_text())
)


def settings(name):
    return yaml.safe_load((MOVEIT / name).read_text())


def above(link):
    """Joints that lead from the world to a link, from there on down; fixed ones too."""
    chain = []
    while link != "world":
        joint = next(joint for joint in JOINTS.values() if joint.find("child").get("link") == link)
        chain.insert(0, joint)
        link = joint.find("parent").get("link")
    return chain


def drives(link):
    """Names of the joints that move a link; a jaw that follows is moved by what it follows."""
    moving = [joint for joint in above(link) if joint.get("type") != "fixed"]
    return {(joint if (lead := joint.find("mimic")) is None else lead).get("joint") or joint.get("name")
            for joint in moving}  # fmt: skip


def test_pairs_that_are_not_compared_are_the_neighbours_in_the_sense_of_mcs():
    solid = [name for name in LINKS if ROBOT.find(f"link[@name='{name}']/collision") is not None]
    expected = set()
    for first, second in combinations(solid, 2):
        one, other = drives(first), drives(second)
        two_arms = one and other and not one & other
        if not two_arms and len(one ^ other) <= 2:
            expected.add((first, second))
    pairs = [(pair.get("link1"), pair.get("link2")) for pair in SEMANTICS.findall("disable_collisions")]
    assert len(pairs) == len(set(pairs))
    assert set(pairs) == expected
    bodies = Bodies(CellModel(CELL))
    compared = {frozenset(bodies.pair_names(k)) for k in range(len(bodies.pairs))}
    boxes = {box.name for box in CELL.obstacles}
    mine = {frozenset("world" if name in boxes else name for name in pair) for pair in compared}
    arms = [name for name in solid if name == "world" or not name.endswith(("_palm", "_jaw_1", "_jaw_2", "_body"))]
    assert mine == {frozenset(pair) for pair in combinations(arms, 2)} - {frozenset(pair) for pair in pairs}


def test_home_is_free_for_a_planner_and_the_table_is_not():
    """By another reader of SRDF than MoveIt: pinocchio, with the shapes of the description."""
    model = pin.buildModelFromXML(URDF)
    shapes = pin.buildGeomFromUrdfString(model, URDF, pin.GeometryType.COLLISION)
    shapes.addAllCollisionPairs()
    pin.removeCollisionPairsFromXML(model, shapes, SRDF)
    data, results = model.createData(), pin.GeometryData(shapes)

    def touching(**positions):
        q = pin.neutral(model)
        for name, position in (dict(zip(CELL.joint_names, CELL.home.tolist(), strict=True)) | positions).items():
            q[model.idx_qs[model.getJointId(name)]] = position
        pin.computeCollisions(model, data, shapes, results, q, False)
        return {
            shapes.geometryObjects[body].name
            for pair, found in zip(shapes.collisionPairs, results.collisionResults, strict=True)
            if found.isCollision()
            for body in (pair.first, pair.second)
        }

    assert touching() == set()
    table = [box.name for box in CELL.obstacles].index("table")
    assert f"world_{table}" in touching(left_rotation=np.pi / 2, left_j2=-0.4, left_j3=-1.6)


def test_groups_are_those_of_mcs():
    chains = {
        group.get("name"): [joint.get("name") for joint in above(chain.get("tip_link")) if joint.get("type") != "fixed"]
        for group in SEMANTICS.findall("group")
        for chain in group.findall("chain")
    }
    assert chains == {name: list(group.joints) for name, group in CONFIG.groups.items()}
    both = [group.get("name") for group in SEMANTICS.findall("group[@name='testbed']/group")]
    assert both == list(CONFIG.groups)
    for effector in SEMANTICS.findall("end_effector"):
        parent = effector.get("parent_group")
        assert effector.get("parent_link") == CONFIG.groups[parent].wrist
        joints = {joint.get("name") for joint in SEMANTICS.findall(f"group[@name='{effector.get('group')}']/joint")}
        assert joints == {f"{parent}_gripper", f"{parent}_jaw"} <= JOINTS.keys()
        palm = SEMANTICS.find(f"group[@name='{effector.get('group')}']/link").get("name")
        assert above(palm)[-1].find("parent").get("link") == effector.get("parent_link")
    for element in SEMANTICS.iter():
        for key in ("link1", "link2", "base_link", "tip_link", "parent_link"):
            assert element.get(key) in (None, *LINKS)


def test_states_of_groups_are_home_and_the_ends_of_the_jaws():
    states = {
        (state.get("name"), state.get("group")): {j.get("name"): float(j.get("value")) for j in state.findall("joint")}
        for state in SEMANTICS.findall("group_state")
    }
    home = dict(zip(CELL.joint_names, CELL.home.tolist(), strict=True))
    expected = {("home", name): {j: home[j] for j in group.joints} for name, group in CONFIG.groups.items()}
    for side in CELL.groups:
        joint = f"{side}_gripper"
        expected |= {("open", joint): {joint: CELL.gripper.stroke}, ("closed", joint): {joint: 0.0}}
    assert states == expected


def test_limits_are_those_that_mcs_enforces():
    told = settings("joint_limits.yaml")
    assert told["default_velocity_scaling_factor"] == told["default_acceleration_scaling_factor"] == 1.0
    limits = told["joint_limits"]
    assert list(limits) == [*CELL.joint_names, *(f"{side}_gripper" for side in CELL.groups)]
    for name in limits:
        velocity = limits[name]["max_velocity"]
        assert velocity == pytest.approx(float(JOINTS[name].find("limit").get("velocity")))
        numbers = [value for key, value in limits[name].items() if key.startswith("max_")]
        assert all(isinstance(value, float) for value in numbers)  # MoveIt takes no integers
        for kind in ("acceleration", "jerk"):
            assert limits[name][f"has_{kind}_limits"] == (name in CELL.joint_names)
            if name in CELL.joint_names:
                assert limits[name][f"max_{kind}"] == pytest.approx(getattr(LIMITS[name], kind))


def test_each_group_has_a_solver_and_each_controller_a_server_that_exists():
    assert settings("kinematics.yaml").keys() == CONFIG.groups.keys()
    told = settings("moveit_controllers.yaml")["moveit_simple_controller_manager"]
    names = told.pop("controller_names")
    assert names == list(told) == [*CONFIG.groups, *(slot.name for slot in CONFIG.gripper_slots)]
    for name, controller in told.items():
        assert ACTIONS[f"/{name}/{controller['action_ns']}"] == f"control_msgs/action/{controller['type']}"
        if controller["type"] == "GripperCommand":
            assert controller["joints"] == [controller["command_joint"]] == [name]
            assert isinstance(controller["max_effort"], float)
            assert float(JOINTS[name].find("limit").get("upper")) == CELL.gripper.stroke
        else:
            assert controller["joints"] == list(CONFIG.groups[name].joints)
