"""URDF of the cell."""

from collections.abc import Collection, Mapping
from math import atan2, dist, hypot
from xml.sax.saxutils import quoteattr

from im_cell.robot.cell import Cell
from im_cell.robot.parameters import Box, Camera, Capsule, Gripper, Limits, Vector
from im_cell.robot.tree import ORIGIN, WORLD, Joint, LinkInertia
from im_cell.rotations import rpy_of_matrix

_METAL: Vector = (0.62, 0.63, 0.65)
_DARK: Vector = (0.12, 0.12, 0.14)
_SHEER = 0.35  # opacity of capsules around hulls, which are markers: URDF knows no hull
_PAST_STROKE_M = 1e-3  # a joint at its limit takes pybullet time
#: The palm's mass is part of the last link's. Its inertia is that of the rotors of a wrist, unknown to pybullet: a
#: contact would turn a wrist without rotors. In free motion im_sim.dynamics makes up for it.
_PALM_KG, PALM_KGM2, _JAW_KGM2 = 1e-3, 0.15, 1e-5


def urdf(cell: Cell, *, frames: bool = True, shapes: bool = True, grippers: bool = False, scenery: bool = True) -> str:
    """The cell as physics and control load it, as URDF, one element a line (pybullet does not parse one long line).

    Args:
        cell: Parameters.
        frames: With the massless frames: links fixed to others, and lights. pybullet gives a link without inertia a
            mass of 1 kg, so physics leaves them out.
        shapes: With visual and collision shapes.
        grippers: With palms and jaws, which have mass then, and are drawn instead of the last links.
        scenery: With the boxes that stand still (:func:`scenery_urdf`).
    """
    lines = ['<link name="world">']
    if shapes:
        lines += [*(_standing(cell) if scenery else ()), *_shapes_of(cell, WORLD)]
    lines.append("</link>")
    hidden = _behind_grippers(cell) if grippers else ()
    for joint, link in zip(cell.joints, cell.links, strict=True):
        shape = _shapes_of(cell, link.name, hidden) if shapes else []
        lines += [*_joint(joint, joint.limits), *_link(link, shape)]
    if frames:
        lines += _frames(cell)
    if grippers:
        for name, tip in cell.devices("gripper").items():
            wrist = cell.tree.carrier(tip)
            group = name.removesuffix("_gripper")
            lines += _gripper(group, cell.gripper, wrist.parent, wrist.xyz, wrist.rpy, heavy=True)
    return _robot(lines)


def fixed_joint(link: str) -> str:
    """Return the name of the joint that fixes a link: with a dash, which no joint of a group has."""
    return f"{link}-fixed"


def scenery_urdf(cell: Cell) -> str:
    """Return the scenery as URDF: the standing boxes, for drawing."""
    return _robot(['<link name="world">', *_standing(cell), "</link>"])


def _standing(cell: Cell) -> list[str]:
    return [line for box in cell.boxes if box.link == WORLD for line in _visual_box(box)]


def _behind_grippers(cell: Cell) -> set[str]:
    """Return the last links, which are not drawn: grippers are, which their shapes enclose."""
    return {cell.tree.carrier(tip).parent for tip in cell.devices("gripper").values()}


def robot_description(cell: Cell, limits: Mapping[str, Limits]) -> str:
    """The cell for tools that show it or plan in it, as URDF: also what they may collide with, grippers and cameras.

    The joint ``<group>_gripper`` is between the jaws, its position the opening; the other jaw moves with it. Grippers
    are drawn, not the last links, whose shapes for collision enclose them. Capsules around hulls are sheer.

    Args:
        cell: Parameters.
        limits: Limits in force of each joint, by name.
    """
    lines = ['<link name="world">']
    for box in cell.boxes:
        if box.link == WORLD:
            lines += [*_visual_box(box), *(_collision(box.center, ORIGIN, _box(box.size)) if box.collision else ())]
    lines += [*_shapes_of(cell, WORLD, (), _SHEER), "</link>"]
    hidden = _behind_grippers(cell)
    for joint, link in zip(cell.joints, cell.links, strict=True):
        lines += [*_joint(joint, limits[joint.name]), *_link(link, _shapes_of(cell, link.name, hidden, _SHEER))]
    lines += _frames(cell)
    for name, tip in cell.devices("gripper").items():
        lines += _gripper(name.removesuffix("_gripper"), cell.gripper, tip)
    for name, camera in cell.cameras.items():
        lines += _camera(name, camera, cell.camera_body)
    return _robot(lines)


def _robot(lines: list[str]) -> str:
    return "\n".join(['<?xml version="1.0"?>', '<robot name="testbed">', *lines, "</robot>", ""])


def _frames(cell: Cell) -> list[str]:
    lines: list[str] = []
    for frame in cell.tree.frames.values():
        lines += _fixed(frame.name, frame.parent, frame.xyz, frame.rpy)
    for name, tip in cell.devices("light").items():
        lines += _fixed(name, tip, cell.led.offset, ORIGIN)
    return lines


def _gripper(
    group: str, gripper: Gripper, parent: str, xyz: Vector = ORIGIN, rpy: Vector = ORIGIN, heavy: bool = False
) -> list[str]:
    """Build a palm and two jaws that meet on the z axis of the wrist and open along its x axis; with mass if heavy."""
    (thickness, _, length), (_, _, depth) = gripper.jaw, gripper.palm
    palm, *jaws = f"{group}_palm", f"{group}_jaw_1", f"{group}_jaw_2"
    solid = _solid(gripper.palm, (0.0, 0.0, gripper.reach - (length + depth) / 2.0), "palm", _METAL)
    small = _inertial(LinkInertia(palm, _PALM_KG, ORIGIN, ORIGIN, (PALM_KGM2,) * 3)) if heavy else []
    lines = _fixed(palm, parent, xyz, rpy, [*small, *solid])
    weight = _inertial(LinkInertia(palm, gripper.jaw_mass, ORIGIN, ORIGIN, (_JAW_KGM2,) * 3)) if heavy else []
    beyond = _PAST_STROKE_M if heavy else 0.0
    travels = (
        (f"{group}_jaw", palm, (0.0, 0.0, gripper.reach), -1.0, 0.5),
        (f"{group}_gripper", jaws[0], ORIGIN, 1.0, 1.0),
    )
    for jaw, (name, parent, xyz, sign, share) in zip(jaws, travels, strict=True):
        lines += [
            f'<joint name="{name}" type="prismatic">',
            f'<parent link="{parent}"/>',
            f'<child link="{jaw}"/>',
            _origin(xyz, ORIGIN),
            f'<axis xyz="{_join((sign, 0.0, 0.0))}"/>',
            f'<limit lower="0.0" upper="{share * gripper.stroke + beyond!r}" '
            f'effort="{gripper.force!r}" velocity="{share * gripper.rate!r}"/>',
            *([f'<mimic joint="{group}_gripper" multiplier="{share!r}" offset="0.0"/>'] if share != 1.0 else []),
            "</joint>",
            f'<link name="{jaw}">',
            *weight,
            *_solid(gripper.jaw, (sign * thickness / 2.0, 0.0, 0.0), "jaw", _METAL),
            "</link>",
        ]
    return lines


def _camera(name: str, camera: Camera, size: Vector) -> list[str]:
    """Build a box behind the lens, at the nominal mount."""
    x, y, z = (camera.axes() @ (0.0, 0.0, -size[2] / 2.0) + camera.position).tolist()
    roll, pitch, yaw = rpy_of_matrix(camera.axes())
    return _fixed(f"{name}_body", camera.parent, (x, y, z), (roll, pitch, yaw), _solid(size, ORIGIN, "camera", _DARK))


def _joint(joint: Joint, limits: Limits) -> list[str]:
    return [
        f'<joint name="{joint.name}" type="{joint.kind}">',
        f'<parent link="{joint.parent}"/>',
        f'<child link="{joint.child}"/>',
        _origin(joint.xyz, joint.rpy),
        f'<axis xyz="{_join(joint.axis)}"/>',
        f'<limit lower="{limits.lower!r}" upper="{limits.upper!r}" '
        f'effort="{limits.torque!r}" velocity="{limits.velocity!r}"/>',
        "</joint>",
    ]


def _fixed(name: str, parent: str, xyz: Vector, rpy: Vector, shapes: list[str] | None = None) -> list[str]:
    return [
        *([f'<link name="{name}">', *shapes, "</link>"] if shapes else [f'<link name="{name}"/>']),
        f'<joint name="{fixed_joint(name)}" type="fixed">',
        f'<parent link="{parent}"/>',
        f'<child link="{name}"/>',
        _origin(xyz, rpy),
        "</joint>",
    ]


def _link(link: LinkInertia, shapes: list[str]) -> list[str]:
    return [f'<link name="{link.name}">', *_inertial(link), *shapes, "</link>"]


def _inertial(link: LinkInertia) -> list[str]:
    ixx, iyy, izz = link.inertia
    return [
        "<inertial>",
        _origin(link.com, link.rpy),
        f'<mass value="{link.mass!r}"/>',
        f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/>',
        "</inertial>",
    ]


def _shapes_of(cell: Cell, link: str, hidden: Collection[str] = (), around_hulls: float = 1.0) -> list[str]:
    """Build the shapes of a moving link or of the world; hidden links are not drawn."""
    lines = [line for box in cell.boxes if box.link == link != WORLD for line in _visual_box(box)]
    color, compared = cell.color_of(link), cell.capsules_compared
    for capsule in cell.bodies:
        placed = cell.tree.on_carrier(capsule)
        if placed.link == link:
            drawn = placed.model_copy(update={"visual": False}) if link in hidden else placed
            lines += _capsule(drawn, color, 1.0 if capsule in compared else around_hulls)
    return lines


def _visual_box(box: Box) -> list[str]:
    return _visual(box.center, ORIGIN, _box(box.size), _material(box.name + "_" + box.link, box.color))


def _solid(size: Vector, center: Vector, name: str, color: Vector) -> list[str]:
    """Build a box that is drawn and that things collide with."""
    return [
        *_visual(center, ORIGIN, _box(size), _material(name, color)),
        *_collision(center, ORIGIN, _box(size)),
    ]


def _capsule(capsule: Capsule, color: Vector, opacity: float) -> list[str]:
    """Build a cylinder with a ball at each end: capsules are not part of URDF."""
    (x0, y0, z0), (x1, y1, z1) = capsule.p0, capsule.p1
    middle = ((x0 + x1) / 2.0, (y0 + y1) / 2.0, (z0 + z1) / 2.0)
    flat, length = hypot(x1 - x0, y1 - y0), dist(capsule.p0, capsule.p1)
    along = (0.0, atan2(flat, z1 - z0), atan2(y1 - y0, x1 - x0))  # turns z into the axis
    ball = f'<sphere radius="{capsule.radius!r}"/>'
    cylinder = f'<cylinder radius="{capsule.radius!r}" length="{length!r}"/>'
    name = capsule.link if opacity == 1.0 else f"{capsule.link}_sheer"
    lines: list[str] = []
    for center, rpy, shape in ((middle, along, cylinder), (capsule.p0, ORIGIN, ball), (capsule.p1, ORIGIN, ball)):
        if capsule.visual:
            lines += _visual(center, rpy, shape, _material(name, color, opacity))
        lines += _collision(center, rpy, shape)
    return lines


def _visual(xyz: Vector, rpy: Vector, shape: str, material: str) -> list[str]:
    return ["<visual>", _origin(xyz, rpy), f"<geometry>{shape}</geometry>", material, "</visual>"]


def _collision(xyz: Vector, rpy: Vector, shape: str) -> list[str]:
    return ["<collision>", _origin(xyz, rpy), f"<geometry>{shape}</geometry>", "</collision>"]


def _box(size: Vector) -> str:
    return f'<box size="{_join(size)}"/>'


def _material(name: str, color: Vector, opacity: float = 1.0) -> str:
    return f'<material name={quoteattr(name)}><color rgba="{_join(color)} {opacity!r}"/></material>'


def _origin(xyz: Vector, rpy: Vector) -> str:
    return f'<origin xyz="{_join(xyz)}" rpy="{_join(rpy)}"/>'


def _join(values: Vector) -> str:
    return " ".join(repr(float(value)) for value in values)
