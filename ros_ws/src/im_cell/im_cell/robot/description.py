"""Robots as URDF describes them: joints, links and shapes, with sentences about faults."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from im_cell.robot.parameters import LARGEST_M, Vector, require_metres, require_radians
from im_core.errors import ConfigError, shortened

MOVING = ("revolute", "continuous", "prismatic")
_MOST_LINKS = 500
_ROUNDING = 1e-6
_LONGEST_NAME = 100
_LARGEST_GYRATION_M = 5.0
"""Of a link's radius of gyration: the half length of the longest link; one in kg mm2 seems to have ten or more."""
_LARGEST_RAD = 30.0
"""Of a limit of an angle: no joint with limits makes five turns to a side, but one in degrees seems to."""
_MOST_LOAD = 20.0
"""Of a link's weight, in limits of its joint's effort: an arm that lifts itself is below 1, one in grams above 50."""


@dataclass(frozen=True)
class UrdfJoint:
    """A joint as the file has it.

    Attributes:
        name, kind: Its name and type.
        parent, child: Links.
        xyz, rpy: Pose in the parent's frame at position 0 [m, rad].
        axis: In the joint's frame.
        lower, upper, velocity, effort: Limits [rad or m, by s, Nm or N]; None where the file has none.
        mimic: Joint that it follows; empty: none.
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    lower: float | None
    upper: float | None
    velocity: float | None
    effort: float | None
    mimic: str


@dataclass(frozen=True)
class UrdfGeometry:
    """A collision shape.

    Attributes:
        kind: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
        size: Edges; radius and length; radius; or scale of the mesh [m or 1].
        mesh: File of the mesh, as written.
        xyz, rpy: Pose in the link's frame [m, rad].
    """

    kind: str
    size: tuple[float, ...]
    mesh: str
    xyz: Vector
    rpy: Vector


@dataclass(frozen=True)
class UrdfLink:
    """A link as the file has it.

    Attributes:
        name: Its name.
        mass: [kg]; 0: the file has none.
        com, rpy: Pose of the inertia's axes in the link's frame [m, rad].
        inertia: xx, xy, xz, yy, yz, zz about the centre of mass [kg m2].
        shapes: For collision.
    """

    name: str
    mass: float
    com: Vector
    rpy: Vector
    inertia: tuple[float, ...]
    shapes: tuple[UrdfGeometry, ...]


@dataclass(frozen=True)
class UrdfTree:
    """A tree of links, root first; children of a link by the names of their joints, as pinocchio has them."""

    root: str
    joints: tuple[UrdfJoint, ...]
    links: dict[str, UrdfLink]


@lru_cache(maxsize=8)
def parse_description(text: str, name: str) -> UrdfTree:
    """Read a URDF.

    Raises:
        ConfigError: It is not XML or no URDF, a number is none, or links and joints are no tree.
    """
    robot = _robot(text, name)
    try:
        links: dict[str, UrdfLink] = {}
        for link in map(_link, robot.findall("link")):
            if link.name in links:
                raise ValueError(f"two links have the same name, '{link.name}'")
            links[link.name] = link
        if len(links) > _MOST_LINKS:
            raise ValueError(f"it has {len(links)} links; {_MOST_LINKS} are allowed")
        joints = [_joint(each) for each in robot.findall("joint")]
        tree = _tree(links, joints)
        for each in joints:
            _require_strength(each, links[each.child])
        return tree
    except ValueError as error:
        raise ConfigError(f"{name}: {error}", file=name) from error


def disabled_pairs(text: str, name: str) -> frozenset[frozenset[str]]:
    """Return the pairs of links switched off by an SRDF (MoveIt's).

    Raises:
        ConfigError: It is not XML or no SRDF.
    """
    pairs = [(each.get("link1"), each.get("link2")) for each in _robot(text, name).findall("disable_collisions")]
    named = [frozenset((first, second)) for first, second in pairs if first and second]
    if len(named) < len(pairs):
        raise ConfigError(f"{name}: a <disable_collisions> lacks its link1 or link2", file=name)
    return frozenset(named)


def _robot(text: str, name: str) -> ET.Element:
    try:
        robot = ET.fromstring(text)
    except ET.ParseError as error:
        raise ConfigError(f"{name}: is not XML: {error}", file=name) from error
    if robot.tag != "robot":
        raise ConfigError(f"{name}: its outermost element is <{shortened(robot.tag)}>, not <robot>", file=name)
    return robot


def _tree(links: dict[str, UrdfLink], joints: list[UrdfJoint]) -> UrdfTree:
    if not links:
        raise ValueError("it has no links; macros are expanded where its name ends in .xacro")
    below: dict[str, list[UrdfJoint]] = {name: [] for name in links}
    carried: dict[str, str] = {}
    names: set[str] = set()
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise ValueError(f"joint {joint.name} names the link '{shortened(link)}', which is not there")
        if joint.name in names:
            raise ValueError(f"two joints have the same name, '{joint.name}'")
        if joint.child in carried:
            text = f"link {joint.child} hangs on two joints, {carried[joint.child]} and {joint.name}"
            raise ValueError(f"{text}: a closed chain, which cannot be simulated or controlled here")
        names.add(joint.name)
        carried[joint.child] = joint.name
        below[joint.parent].append(joint)
    for joint in joints:
        if joint.mimic and joint.mimic not in names - {joint.name}:
            why = "itself" if joint.mimic == joint.name else f"'{shortened(joint.mimic)}' (mimic), which is not there"
            raise ValueError(f"joint {joint.name} follows {why}")
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        told = f"{len(roots)} links are roots: {', '.join(roots)}" if roots else "no link is the root"
        raise ValueError(f"{told}; one link, which nothing carries, must carry all others")

    def walk(link: str) -> Iterator[UrdfJoint]:
        for joint in sorted(below[link], key=lambda each: each.name):
            yield joint
            yield from walk(joint.child)

    ordered = tuple(walk(roots[0]))
    if len(ordered) < len(joints):
        lost = sorted(names - {joint.name for joint in ordered})
        raise ValueError(f"joints {', '.join(lost)} are a closed chain, which the root does not carry")
    away = {roots[0]: 0.0}
    for joint in ordered:
        away[joint.child] = away[joint.parent] + math.hypot(*joint.xyz)
    if (far := max(away.values())) > LARGEST_M:
        told = f"its links are up to {far:.3g} m from {roots[0]}, beyond {LARGEST_M:g} m"
        raise ValueError(f"{told}: lengths are millimetres, it seems")
    return UrdfTree(roots[0], ordered, links)


def _require_strength(joint: UrdfJoint, link: UrdfLink) -> None:
    """Refuse a joint far too weak for the weight of the carried link.

    Raises:
        ValueError: It is.
    """
    needed = 9.81 * link.mass * float(np.linalg.norm(np.cross(joint.axis, link.com)))
    if joint.kind in ("revolute", "continuous") and joint.effort and needed > _MOST_LOAD * joint.effort:
        told = f"joint {joint.name} has {joint.effort:g} Nm, and link {link.name} of {link.mass:g} kg"
        raise ValueError(f"{told} needs up to {needed:.3g} Nm: masses are grams, it seems")


def _link(element: ET.Element) -> UrdfLink:
    name = _name(element, "link")
    inertial, mass = element.find("inertial"), 0.0
    inertia: tuple[float, ...] = (0.0,) * 6
    xyz, rpy = _origin(inertial, name)
    if inertial is not None:
        mass = _number(_child(inertial, "mass", name), "value", name)
        moments = _child(inertial, "inertia", name)
        inertia = tuple(_number(moments, key, name) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        if min(mass, inertia[0], inertia[3], inertia[5]) < 0.0:
            raise ValueError(f"link {name} has a mass or a moment of inertia below 0")
        xx, xy, xz, yy, yz, zz = inertia
        least = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])[0]
        if least < -_ROUNDING * max(inertia):
            raise ValueError(f"link {name}: its principal moments of inertia, of which one is {least:.3g}, cannot be")
        if mass > 0.0 and (gyration := math.sqrt(max(inertia) / mass)) > _LARGEST_GYRATION_M:
            told = f"link {name} of {mass:g} kg has {max(inertia):g} kg m2, as if {gyration:.3g} m away from its centre"
            raise ValueError(f"{told}: inertias are kg mm2, it seems")
    return UrdfLink(name, mass, xyz, rpy, inertia, tuple(_shape(each, name) for each in element.findall("collision")))


def _shape(element: ET.Element, link: str) -> UrdfGeometry:
    xyz, rpy = _origin(element, link)
    geometry = _child(element, "geometry", link)
    if (box := geometry.find("box")) is not None:
        return UrdfGeometry("box", _sizes(_numbers(box.get("size", ""), 3, link), link), "", xyz, rpy)
    if (cylinder := geometry.find("cylinder")) is not None:
        size = (_number(cylinder, "radius", link), _number(cylinder, "length", link))
        return UrdfGeometry("cylinder", _sizes(size, link), "", xyz, rpy)
    if (sphere := geometry.find("sphere")) is not None:
        return UrdfGeometry("sphere", _sizes((_number(sphere, "radius", link),), link), "", xyz, rpy)
    if (mesh := geometry.find("mesh")) is None:
        raise ValueError(f"{link}: a shape for collision is none of box, cylinder, sphere, mesh")
    scale = _numbers(mesh.get("scale", "1 1 1"), 3, link)
    _sizes(tuple(map(abs, scale)), link)  # mirrored meshes have a scale below 0
    if not (file := mesh.get("filename", "")):
        raise ValueError(f"{link}: a mesh for collision has no file name")
    return UrdfGeometry("mesh", scale, file, xyz, rpy)


def _sizes(size: tuple[float, ...], link: str) -> tuple[float, ...]:
    if min(size) <= 0.0:
        raise ValueError(f"{link}: a shape for collision has the size {min(size):g}; more than 0 is needed")
    if max(size) > 2.0 * LARGEST_M:
        raise ValueError(f"{link}: a shape for collision is {max(size):g} m large: lengths are millimetres, it seems")
    return size


def _joint(element: ET.Element) -> UrdfJoint:
    name, kind = _name(element, "joint"), element.get("type", "")
    if kind not in (*MOVING, "fixed"):
        known = ", ".join((*MOVING, "fixed"))
        raise ValueError(f"joint {name} is of type '{shortened(kind)}', not one of {known}")
    xyz, rpy = _origin(element, name)
    axis_element, limit, mimic = element.find("axis"), element.find("limit"), element.find("mimic")
    axis: Vector = (1.0, 0.0, 0.0)
    if axis_element is not None:
        x, y, z = _numbers(axis_element.get("xyz", ""), 3, name)
        length = math.sqrt(x * x + y * y + z * z)
        if length < 1e-9 and kind != "fixed":
            raise ValueError(f"the axis of joint {name} has no direction")
        axis = (x, y, z) if abs(length - 1.0) < 1e-12 or length < 1e-9 else (x / length, y / length, z / length)
    values = {key: _number(limit, key, name) if limit is not None and limit.get(key) is not None else None
              for key in ("lower", "upper", "velocity", "effort")}  # fmt: skip
    if values["lower"] is not None or values["upper"] is not None:  # of the two that are missing, URDF means 0
        values["lower"], values["upper"] = values["lower"] or 0.0, values["upper"] or 0.0
    for key in ("velocity", "effort"):
        if (values[key] or 0.0) < 0.0:
            raise ValueError(f"joint {name}: its limit of {key} is {values[key]:g}; more than 0 is needed")
    if (values["lower"] or 0.0) > (values["upper"] or 0.0):
        raise ValueError(f"joint {name}: its limit lower {values['lower']} is above upper {values['upper']}")
    if kind == "revolute" and max(abs(values["lower"] or 0.0), abs(values["upper"] or 0.0)) > _LARGEST_RAD:
        told = f"joint {name} turns from {values['lower'] or 0.0:g} to {values['upper'] or 0.0:g} rad"
        raise ValueError(f"{told}: its limits are degrees, it seems; a joint without limits is continuous")
    parent, child = (_child(element, each, name).get("link", "") for each in ("parent", "child"))
    return UrdfJoint(
        name, kind, parent, child, xyz, rpy, axis, **values,
        mimic="" if mimic is None else mimic.get("joint", "") or "(none)",
    )  # fmt: skip


def _name(element: ET.Element, what: str) -> str:
    if not (name := element.get("name", "")):
        raise ValueError(f"a {what} has no name")
    if sign := next((sign for sign in name if sign in "<>&\"'"), ""):
        raise ValueError(f"{what} '{shortened(name)}': no name may have the sign {sign}")
    if len(name) > _LONGEST_NAME:
        raise ValueError(f"{what} '{shortened(name)}': its name has {len(name)} letters; {_LONGEST_NAME} are allowed")
    return name


def _child(element: ET.Element, tag: str, of: str) -> ET.Element:
    if (found := element.find(tag)) is None:
        raise ValueError(f"{of}: there is no <{tag}> in its <{element.tag}>")
    return found


def _origin(element: ET.Element | None, of: str) -> tuple[Vector, Vector]:
    origin = None if element is None else element.find("origin")
    if element is None or origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    (x, y, z), (roll, pitch, yaw) = (_numbers(origin.get(key, "0 0 0"), 3, of) for key in ("xyz", "rpy"))
    what = of if element.tag == "joint" else f"{of}: its <{element.tag}>"
    try:
        return require_metres((x, y, z)), require_radians((roll, pitch, yaw))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error


def _number(element: ET.Element, key: str, of: str) -> float:
    (value,) = _numbers(element.get(key, ""), 1, f"{of}: {key}")
    return value


def _numbers(text: str, count: int, of: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) < 1e9 for value in values):
        raise ValueError(f"{of}: '{shortened(text)}' is not {count} number{'s' * (count > 1)} below 1e9")
    return values
