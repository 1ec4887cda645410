"""Semantics of a cell for MoveIt: groups and pairs not compared (SRDF), limits, solvers, controllers."""

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import yaml

from im_cell.robot import Cell, Group, Limits, robot_description
from im_cell.robot.tree import WORLD
from im_mcs.collision.bodies import NEIGHBOURS, Bodies
from im_mcs.inverse.arm import ARM_JOINTS
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

_SOLVER = "kdl_kinematics_plugin/KDLKinematicsPlugin"
_MANAGER = "moveit_simple_controller_manager"


def moveit_files(cell: Cell, config: McsConfig) -> dict[str, str]:
    """Return the texts of the files by name, for the groups of the preset in force.

    Args:
        cell: The cell; MoveIt reads the robot itself from ``/robot_description``.
        config: Preset, and shares of the limits.
    """
    limits = JointLimits(cell, config.limits, config.slots).enforced()
    robot = _Robot(cell, limits)
    groups = config.groups
    return {
        "cell.srdf": _srdf(cell, config, robot),
        "joint_limits.yaml": _yaml(
            "Limits that MCS plans with and enforces: those of /robot_description, with accelerations and jerks.",
            {
                "default_velocity_scaling_factor": 1.0,
                "default_acceleration_scaling_factor": 1.0,
                "joint_limits": {
                    **{
                        name: _limits(each.velocity, acceleration=each.acceleration, jerk=each.jerk)
                        for name, each in limits.items()
                    },
                    **{name: _limits(cell.gripper.rate) for name in cell.devices("gripper")},
                },
            },
        ),
        "kinematics.yaml": _yaml(
            "Solvers of the groups that are chains. With few joints a tip has not every orientation.",
            {name: _solver(len(group.joints)) for name, group in groups.items() if robot.is_chain(group)},
        ),
        "moveit_controllers.yaml": _yaml(
            f"Action servers of /mcs for the preset {config.preset}. MoveIt waits longer than planned: MCS slows down\n"
            "# near bodies, may retime a trajectory, and answers when the group is at rest.",
            {
                "moveit_controller_manager": f"{_MANAGER}/MoveItSimpleControllerManager",
                "trajectory_execution": {
                    "allowed_execution_duration_scaling": 2.0,
                    "allowed_goal_duration_margin": 4.0,
                    "allowed_start_tolerance": 0.01,
                },
                _MANAGER: {
                    "controller_names": [*groups, *cell.devices("gripper")],
                    **{name: _trajectories(group) for name, group in groups.items()},
                    **{name: _gripper_commands(name) for name in cell.devices("gripper")},
                },
            },
        ),
    }


class _Robot:
    """Tree of the robot description."""

    def __init__(self, cell: Cell, limits: Mapping[str, Limits]) -> None:
        self._cell, root = cell, ET.fromstring(robot_description(cell, limits))
        self._above = {_link(joint, "child"): joint for joint in root.iter("joint") if joint.find("child") is not None}
        self.solid = [str(link.get("name")) for link in root.iter("link") if link.find("collision") is not None]

    def parent_of(self, moving: str) -> str:
        """Return the link carrying a joint."""
        return next(_link(joint, "parent") for joint in self._above.values() if joint.get("name") == moving)

    def drives(self, link: str) -> list[str]:
        """Return the joints that move a link, from the world on; one that follows counts as the one it follows."""
        found: list[str] = []
        while link in self._above:
            joint = self._above[link]
            mimic = joint.find("mimic")
            if joint.get("type") != "fixed":
                found.insert(0, str(joint.get("name") if mimic is None else mimic.get("joint")))
            link = _link(joint, "parent")
        return found

    def is_chain(self, group: Group) -> bool:
        """Return whether the joints of a group are the last ones below the wrist, without a gap."""
        return group.wrist is not None and self.drives(group.wrist)[-len(group.joints) :] == list(group.joints)

    def apart(self, first: str, second: str) -> int | None:
        """Return the number of joints between two links along the tree; None: the links are of different arms."""
        one, other = set(self.drives(first)), set(self.drives(second))
        return None if one and other and not one & other else len(one ^ other)

    def carrier(self, link: str) -> str:
        """Return the link of MCS that carries a link, or the world: jaws are on that of their wrist."""
        while link in self._above and self._above[link].get("name") not in self._cell.joint_names:
            link = _link(self._above[link], "parent")
        return link


def _srdf(cell: Cell, config: McsConfig, robot: _Robot) -> str:
    root = ET.Element("robot", name="testbed")
    home = dict(zip(cell.joint_names, cell.home.tolist(), strict=True))
    for name, group in config.groups.items():
        element = ET.SubElement(root, "group", name=name)
        if robot.is_chain(group):
            ET.SubElement(element, "chain", base_link=robot.parent_of(group.joints[0]), tip_link=str(group.wrist))
        else:
            _joints(element, group.joints)
        _joints(
            ET.SubElement(root, "group_state", name="home", group=name), {each: home[each] for each in group.joints}
        )
    _add_unions(root, config)
    grippers = cell.devices("gripper")
    for name, tip in grippers.items():
        arm = name.removesuffix("_gripper")
        element = ET.SubElement(root, "group", name=name)
        ET.SubElement(element, "link", name=f"{arm}_palm")
        _joints(element, (f"{arm}_jaw", name))
        for state, opening in (("open", cell.gripper.stroke), ("closed", 0.0)):
            _joints(ET.SubElement(root, "group_state", name=state, group=name), {name: opening})
        carrying = [group for group, each in config.groups.items() if tip in each.frames]
        above = {"parent_group": carrying[0]} if carrying else {}
        ET.SubElement(root, "end_effector", {"name": name, "parent_link": tip, "group": name, **above})
    for first, second, reason in _untouching(cell, robot):
        ET.SubElement(root, "disable_collisions", link1=first, link2=second, reason=reason)
    ET.indent(root)
    return (
        '<?xml version="1.0"?>\n'
        f"<!-- Groups of the preset {config.preset}. As in MCS, neighbours are not compared, nor pairs that the cell\n"
        f"     names. -->\n{ET.tostring(root, encoding='unicode')}\n"
    )


def _add_unions(root: ET.Element, config: McsConfig) -> None:
    """Add the groups of other presets that are several groups in force together: MoveIt plans for all at once."""
    for groups in config.presets.values():
        for name, group in groups.items():
            parts = [part for part, each in config.groups.items() if {*each.joints} <= {*group.joints}]
            if name not in config.groups and sum(len(config.groups[part].joints) for part in parts) == len(
                group.joints
            ):
                element = ET.SubElement(root, "group", name=name)
                for part in parts:
                    ET.SubElement(element, "group", name=part)


def _untouching(cell: Cell, robot: _Robot) -> list[tuple[str, str, str]]:
    """Return the pairs of links excluded from the comparison, with the reason.

    MCS has no bodies of grippers and cameras: their pairs are those of the links that carry them, and neighbours. What
    stands still is one link for MoveIt: a link that must not be compared with one part of it is compared with none.
    """
    bodies = Bodies(CellModel(cell))
    boxes = {box.name for box in cell.obstacles}
    carrier = {name: WORLD if name in boxes else robot.carrier(name) for name in bodies.names}
    compared = {frozenset(carrier[name] for name in bodies.pair_names(pair)) for pair in range(len(bodies.pairs))}
    named = {frozenset(carrier.get(name, name) for name in pair) for pair in cell.untouching}
    standing = {pair for pair in named if WORLD in pair}
    found = []
    for first, second in itertools.combinations(robot.solid, 2):
        apart = robot.apart(first, second)
        carriers = frozenset((robot.carrier(first), robot.carrier(second)))
        if apart is not None and apart <= NEIGHBOURS:
            found.append((first, second, "Adjacent"))
        elif carriers in standing | (named - compared):
            found.append((first, second, "Never"))
    return found


def _joints(element: ET.Element, joints: tuple[str, ...] | Mapping[str, float]) -> None:
    for name in joints:
        value = {"value": repr(joints[name])} if isinstance(joints, Mapping) else {}
        ET.SubElement(element, "joint", {"name": name, **value})


def _limits(velocity: float, **others: float) -> dict[str, object]:
    told: dict[str, object] = {"has_velocity_limits": True, "max_velocity": velocity}
    for kind in ("acceleration", "jerk"):
        told[f"has_{kind}_limits"] = kind in others
        if kind in others:
            told[f"max_{kind}"] = others[kind]
    return told


def _solver(joints: int) -> dict[str, object]:
    only = {"position_only_ik": True} if joints < ARM_JOINTS else {}
    return {
        "kinematics_solver": _SOLVER,
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.05,
        **only,
    }


def _trajectories(group: Group) -> dict[str, object]:
    return {
        "type": "FollowJointTrajectory",
        "action_ns": "follow_joint_trajectory",
        "default": True,
        "joints": list(group.joints),
    }


def _gripper_commands(name: str) -> dict[str, object]:
    """Return the settings of a gripper: an effort of 0 means the full force."""
    return {
        "type": "GripperCommand",
        "action_ns": "gripper_cmd",
        "default": True,
        "max_effort": 0.0,
        "command_joint": name,
        "joints": [name],
    }


def _yaml(comment: str, data: object) -> str:
    return f"# {comment}\n{yaml.safe_dump(data, sort_keys=False)}"


def _link(joint: ET.Element, end: str) -> str:
    found = joint.find(end)
    return "" if found is None else str(found.get("link"))
