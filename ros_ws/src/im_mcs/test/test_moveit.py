"""What MoveIt is told of a cell, against the robot description, MCS, the servers that there are, and others' files."""

import re
import xml.etree.ElementTree as ET
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from im_cell.robot import load_cell, robot_description, shipped_cells
from im_mcs.cell.semantics import moveit_files
from im_mcs.collision import Bodies
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

ACTIONS = dict(
    re.findall(r"\| `(/\S+)` \| `(\S+)` \|", (Path(__file__).parents[4] / "docs" / "interfaces.md").read_text())
)
#: Links of MoveIt's own Panda (``moveit_resources_panda_moveit_config``, ``panda.srdf``), by ours.
PANDA = {
    "panda_link0": "world",
    **{f"panda_link{number}": f"panda_link{number}" for number in range(1, 8)},
    "panda_hand": "arm_palm",
    "panda_leftfinger": "arm_jaw_1",
    "panda_rightfinger": "arm_jaw_2",
}
#: Pairs that are adjacent there.
PANDA_ADJACENT = [
    *((f"panda_link{number}", f"panda_link{number + 1}") for number in range(7)),
    ("panda_hand", "panda_link7"),
    ("panda_hand", "panda_leftfinger"),
    ("panda_hand", "panda_rightfinger"),
]


#: Groups that move all groups of the preset in force together.
UNIONS = {"puma_pair": "testbed", "ur_pair": "all"}


class Told:
    """The files for a cell, and what they must agree with."""

    def __init__(self, name, preset=""):
        self.cell = load_cell(name)
        config = load_config(cell=self.cell)
        self.config = config.model_copy(update={"preset": preset or config.preset})
        self.limits = JointLimits(self.cell, self.config.limits, self.config.slots).enforced()
        self.urdf = robot_description(self.cell, self.limits)
        self.robot = ET.fromstring(self.urdf)
        self.files = moveit_files(self.cell, self.config)
        self.semantics = ET.fromstring(self.files["cell.srdf"])
        self.links = [link.get("name") for link in self.robot.findall("link")]
        self.joints = {joint.get("name"): joint for joint in self.robot.findall("joint")}

    def settings(self, name):
        return yaml.safe_load(self.files[name])

    @cached_property
    def untouching(self):
        pairs = [(pair.get("link1"), pair.get("link2")) for pair in self.semantics.findall("disable_collisions")]
        assert len({frozenset(pair) for pair in pairs}) == len(pairs)
        return {frozenset(pair) for pair in pairs}

    def above(self, link):
        """Joints that lead from the world to a link, from there on down; fixed ones too."""
        chain = []
        while link != "world":
            joint = next(joint for joint in self.joints.values() if joint.find("child").get("link") == link)
            chain.insert(0, joint)
            link = joint.find("parent").get("link")
        return chain

    def drives(self, link):
        """Names of the joints that move a link; a jaw that follows is moved by what it follows."""
        moving = [joint for joint in self.above(link) if joint.get("type") != "fixed"]
        leads = [joint if (lead := joint.find("mimic")) is None else lead for joint in moving]
        return {lead.get("joint") or lead.get("name") for lead in leads}


@pytest.fixture(scope="module", params=shipped_cells())
def told(request):
    return Told(request.param)


def test_pairs_that_are_not_compared_are_the_neighbours_and_those_of_the_cell_in_the_sense_of_mcs(told):
    solid = [name for name in told.links if told.robot.find(f"link[@name='{name}']/collision") is not None]
    near = {frozenset(pair) for pair in combinations(solid, 2) if len(told.drives(pair[0]) ^ told.drives(pair[1])) <= 1}
    assert near <= told.untouching
    bodies = Bodies(CellModel(told.cell))
    boxes = {box.name for box in told.cell.obstacles}
    place = {name: "world" if name in boxes else told.cell.tree.carrier(name).parent for name in bodies.names}
    compared = {frozenset(place[name] for name in bodies.pair_names(k)) for k in range(len(bodies.pairs))}
    left = {frozenset(pair) for pair in combinations(dict.fromkeys(place.values()), 2)} - told.untouching
    assert left <= compared
    assert all("world" in pair for pair in compared - left)  # one link for MoveIt, of which a part may not be compared
    for extra in told.untouching - near:  # the cell names them: of links, or of what is fixed to links
        assert extra <= {*place.values()} or any(
            link.endswith(("_palm", "_jaw_1", "_jaw_2", "_body")) for link in extra
        )


def test_pairs_of_a_panda_are_those_of_its_own_moveit_configuration(told):
    told = Told("panda")
    assert {frozenset((PANDA[first], PANDA[second])) for first, second in PANDA_ADJACENT} <= told.untouching
    (chain,) = told.semantics.findall("group[@name='arm']/chain")
    joints = [joint.get("name") for joint in told.above(chain.get("tip_link")) if joint.get("type") != "fixed"]
    assert joints == [f"panda_joint{number}" for number in range(1, 8)]
    ready = {
        joint.get("name"): joint.get("value") for joint in told.semantics.findall("group_state[@group='arm']/joint")
    }
    assert ready == {"panda_joint1": "0.0", "panda_joint2": "-0.785", "panda_joint3": "0.0", "panda_joint4": "-2.356",
                     "panda_joint5": "0.0", "panda_joint6": "1.571", "panda_joint7": "0.785"}  # fmt: skip


def test_home_is_free_for_a_planner_and_a_table_is_not(told):
    """By another reader of SRDF than MoveIt: pinocchio, with the shapes of the description."""
    cell, model = told.cell, pin.buildModelFromXML(told.urdf)
    shapes = pin.buildGeomFromUrdfString(model, told.urdf, pin.GeometryType.COLLISION)
    shapes.addAllCollisionPairs()
    pin.removeCollisionPairsFromXML(model, shapes, told.files["cell.srdf"])
    data, results = model.createData(), pin.GeometryData(shapes)

    def touching(**positions):
        q = pin.neutral(model)
        for name, position in (dict(zip(cell.joint_names, cell.home.tolist(), strict=True)) | positions).items():
            q[model.idx_qs[model.getJointId(name)]] = position
        pin.computeCollisions(model, data, shapes, results, q, False)
        return {
            shapes.geometryObjects[body].name
            for pair, found in zip(shapes.collisionPairs, results.collisionResults, strict=True)
            if found.isCollision()
            for body in (pair.first, pair.second)
        }

    assert touching() == set()
    low, high = ([getattr(told.limits[name], end) for name in cell.joint_names] for end in ("lower", "upper"))
    anywhere = np.random.default_rng(1).uniform(low, high, (100, len(low))).tolist()
    world = {name for q in anywhere for name in touching(**dict(zip(cell.joint_names, q, strict=True)))}
    assert {f"world_{rank}" for rank in range(len(cell.obstacles))} & world


@pytest.mark.parametrize(("name", "preset"), [*((name, "") for name in shipped_cells()), ("puma_pair", "3x6")])
def test_groups_are_those_of_mcs(name, preset):
    told = Told(name, preset)
    groups = {}
    for group in told.semantics.findall("group"):
        groups[group.get("name")] = [joint.get("name") for joint in group.findall("joint")]
        for chain in group.findall("chain"):
            moving = [joint for joint in told.above(chain.get("tip_link")) if joint.get("type") != "fixed"]
            below = [joint.find("parent").get("link") for joint in moving].index(chain.get("base_link"))
            groups[group.get("name")] += [joint.get("name") for joint in moving[below:]]
            assert chain.get("tip_link") == told.config.groups[group.get("name")].wrist
    assert groups.items() >= {name: list(group.joints) for name, group in told.config.groups.items()}.items()
    union = {group.get("name"): [part.get("name") for part in group.findall("group")]
             for group in told.semantics.findall("group") if group.find("group") is not None}  # fmt: skip
    assert union == ({UNIONS[name]: list(told.config.groups)} if name in UNIONS else {})
    for effector in told.semantics.findall("end_effector"):
        parent = effector.get("parent_group")
        assert effector.get("parent_link") == told.config.groups[parent].wrist
        joints = {
            joint.get("name") for joint in told.semantics.findall(f"group[@name='{effector.get('group')}']/joint")
        }
        assert joints == {f"{parent}_gripper", f"{parent}_jaw"} <= told.joints.keys()
        palm = told.semantics.find(f"group[@name='{effector.get('group')}']/link").get("name")
        assert told.above(palm)[-1].find("parent").get("link") == effector.get("parent_link")
    for element in told.semantics.iter():
        for key in ("link1", "link2", "base_link", "tip_link", "parent_link"):
            assert element.get(key) in (None, *told.links)


def test_states_of_groups_are_home_and_the_ends_of_the_jaws(told):
    states = {
        (state.get("name"), state.get("group")): {j.get("name"): float(j.get("value")) for j in state.findall("joint")}
        for state in told.semantics.findall("group_state")
    }
    home = dict(zip(told.cell.joint_names, told.cell.home.tolist(), strict=True))
    expected = {("home", name): {j: home[j] for j in group.joints} for name, group in told.config.groups.items()}
    for joint in told.cell.devices("gripper"):
        expected |= {("open", joint): {joint: told.cell.gripper.stroke}, ("closed", joint): {joint: 0.0}}
    assert states == expected


def test_limits_are_those_that_mcs_enforces(told):
    settings = told.settings("joint_limits.yaml")
    assert settings["default_velocity_scaling_factor"] == settings["default_acceleration_scaling_factor"] == 1.0
    limits = settings["joint_limits"]
    assert list(limits) == [*told.cell.joint_names, *told.cell.devices("gripper")]
    for name in limits:
        velocity = limits[name]["max_velocity"]
        assert velocity == pytest.approx(float(told.joints[name].find("limit").get("velocity")))
        numbers = [value for key, value in limits[name].items() if key.startswith("max_")]
        assert all(isinstance(value, float) for value in numbers)  # MoveIt takes no integers
        for kind in ("acceleration", "jerk"):
            assert limits[name][f"has_{kind}_limits"] == (name in told.cell.joint_names)
            if name in told.cell.joint_names:
                assert limits[name][f"max_{kind}"] == pytest.approx(getattr(told.limits[name], kind))


def test_each_group_has_a_solver_and_each_controller_a_server_that_exists(told):
    """The servers of all cells are those of the pair of PUMAs, by the names of the groups."""
    solvers = told.settings("kinematics.yaml")
    assert {name: each.get("position_only_ik", False) for name, each in solvers.items()} == {
        name: len(group.joints) < 6 for name, group in told.config.groups.items()
    }
    controllers = told.settings("moveit_controllers.yaml")["moveit_simple_controller_manager"]
    names = controllers.pop("controller_names")
    assert names == list(controllers) == [*told.config.groups, *(slot.name for slot in told.config.gripper_slots)]
    for name, controller in controllers.items():
        grips = controller["type"] == "GripperCommand"
        server = f"/{'left_gripper' if grips else 'left'}/{controller['action_ns']}"
        assert ACTIONS[server] == f"control_msgs/action/{controller['type']}"
        if grips:
            assert controller["joints"] == [controller["command_joint"]] == [name]
            assert isinstance(controller["max_effort"], float)
            assert float(told.joints[name].find("limit").get("upper")) == told.cell.gripper.stroke
        else:
            assert controller["joints"] == list(told.config.groups[name].joints)
