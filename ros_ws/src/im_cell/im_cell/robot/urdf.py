"""URDF of the cell."""

from collections.abc import Mapping
from math import atan2, dist, hypot
from xml.sax.saxutils import quoteattr

from im_cell.robot.cell import Cell
from im_cell.robot.parameters import Box, Capsule, Limits, Vector
from im_cell.robot.tree import ORIGIN, Joint, LinkInertia, far_end


def urdf(cell: Cell, *, frames: bool = True, shapes: bool = True, limits: Mapping[str, Limits] | None = None) -> str:
    """The cell as URDF, one element a line (pybullet does not parse one long line).

    Args:
        cell: Parameters.
        frames: With the massless frames ``<side>_base``, ``<side>_wrist``, ``<side>_led``. pybullet gives a link
            without inertia a mass of 1 kg, so physics leaves them out.
        shapes: With visual and collision shapes.
        limits: Limits of each joint, by name; None: those of the cell.
    """
    lines = ['<?xml version="1.0"?>', '<robot name="testbed">', '<link name="world">']
    if shapes:
        lines += [line for box in cell.boxes for line in _visual_box(box, box.color)]
    lines.append("</link>")
    for joint, link in zip(cell.joints, cell.links, strict=True):
        lines += _joint(joint, joint.limits if limits is None else limits[joint.name])
        lines += [f'<link name="{link.name}">', *_inertial(link)]
        if shapes:
            lines += _shapes_of(cell, link.name)
        lines.append("</link>")
    if frames:
        for side, spec in cell.sides.items():
            arm = cell.arm_models[spec.arm]
            wrist = far_end(arm.links[-1])
            lines += _frame(f"{side}_base", f"{side}_platform", (0.0, 0.0, arm.mount_height), ORIGIN)
            lines += _frame(f"{side}_wrist", f"{side}_link6", *wrist)
            lines += _frame(f"{side}_led", f"{side}_wrist", cell.led.offset, ORIGIN)
    return "\n".join([*lines, "</robot>", ""])


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


def _frame(name: str, parent: str, xyz: Vector, rpy: Vector) -> list[str]:
    return [
        f'<link name="{name}"/>',
        f'<joint name="{name}_fixed" type="fixed">',
        f'<parent link="{parent}"/>',
        f'<child link="{name}"/>',
        _origin(xyz, rpy),
        "</joint>",
    ]


def _inertial(link: LinkInertia) -> list[str]:
    ixx, iyy, izz = link.inertia
    return [
        "<inertial>",
        _origin(link.com, link.rpy),
        f'<mass value="{link.mass!r}"/>',
        f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/>',
        "</inertial>",
    ]


def _shapes_of(cell: Cell, link: str) -> list[str]:
    side, _, part = link.partition("_")
    lines = [line for box in cell.cart.boxes if box.link == part for line in _visual_box(box, box.color)]
    color = cell.sides[side].color
    for capsule in cell.capsules:
        if capsule.link == link:
            lines += _capsule(capsule, color)
    return lines


def _visual_box(box: Box, color: Vector) -> list[str]:
    return [
        "<visual>",
        _origin(box.center, ORIGIN),
        f'<geometry><box size="{_join(box.size)}"/></geometry>',
        _material(box.name + "_" + box.link, color),
        "</visual>",
    ]


def _capsule(capsule: Capsule, color: Vector) -> list[str]:
    """Build a cylinder with a ball at each end: capsules are not part of URDF."""
    (x0, y0, z0), (x1, y1, z1) = capsule.p0, capsule.p1
    middle = ((x0 + x1) / 2.0, (y0 + y1) / 2.0, (z0 + z1) / 2.0)
    flat, length = hypot(x1 - x0, y1 - y0), dist(capsule.p0, capsule.p1)
    along = (0.0, atan2(flat, z1 - z0), atan2(y1 - y0, x1 - x0))  # turns z into the axis
    cylinder = (_origin(middle, along), f'<cylinder radius="{capsule.radius!r}" length="{length!r}"/>')
    balls = [(_origin(end, ORIGIN), f'<sphere radius="{capsule.radius!r}"/>') for end in (capsule.p0, capsule.p1)]
    lines: list[str] = []
    for origin, shape in (cylinder, *balls):
        geometry = f"<geometry>{shape}</geometry>"
        if capsule.visual:
            lines += ["<visual>", origin, geometry, _material(capsule.link, color), "</visual>"]
        lines += ["<collision>", origin, geometry, "</collision>"]
    return lines


def _material(name: str, color: Vector) -> str:
    return f'<material name={quoteattr(name)}><color rgba="{_join(color)} 1.0"/></material>'


def _origin(xyz: Vector, rpy: Vector) -> str:
    return f'<origin xyz="{_join(xyz)}" rpy="{_join(rpy)}"/>'


def _join(values: Vector) -> str:
    return " ".join(repr(float(value)) for value in values)
