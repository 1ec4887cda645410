"""Joints and links of the cell as a tree, ready for URDF.

A URDF link's frame lies on its joint's axis (z for the PUMA joints), a DH frame at the link's far end: with the DH row
``Rz(theta) Tz(d) Tx(a) Rx(alpha)``, the URDF frame of link i is DH frame i-1 turned by theta, and the constant rest
``Tz(d) Tx(a) Rx(alpha)`` places the next joint and, here, the mass.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, pi, sin

from im_cell.robot.parameters import ArmModel, Cart, CartStage, DhLink, Limits, Motor, Side, Vector

ORIGIN: Vector = (0.0, 0.0, 0.0)
CART_LINKS = ("cart", "turntable", "platform")


@dataclass(frozen=True)
class Joint:
    """A moving joint.

    Attributes:
        name: E.g. ``left_j3``.
        kind: ``prismatic`` or ``revolute``.
        axis: In the joint's frame.
        parent, child: URDF links.
        xyz, rpy: Pose of the joint in the parent's frame at position 0 [m, rad].
        limits: What must hold always.
        rotor_inertia: Reflected to the joint [kg m2 or kg].
        viscous: Reflected friction by speed [Nm s/rad or N s/m].
        coulomb_positive, coulomb_negative: Magnitudes of reflected dry friction by direction [Nm or N].
        brake: Reflected torque of the holding brake [Nm or N].
        resolution: Of the encoder [rad or m].
        noise: Standard deviation of the encoder before quantisation [rad or m].
    """

    name: str
    kind: str
    axis: Vector
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    limits: Limits
    rotor_inertia: float
    viscous: float
    coulomb_positive: float
    coulomb_negative: float
    brake: float
    resolution: float
    noise: float


@dataclass(frozen=True)
class LinkInertia:
    """A link with mass.

    Attributes:
        name: E.g. ``left_link3``.
        mass: [kg].
        com: Centre of mass in the link's frame [m].
        rpy: Orientation of the principal axes in the link's frame [rad].
        inertia: Principal inertias about the centre of mass [kg m2].
    """

    name: str
    mass: float
    com: Vector
    rpy: Vector
    inertia: Vector


def joints_of(name: str, side: Side, cart: Cart, arm: ArmModel, counts: int, noise_counts: float) -> Iterator[Joint]:
    """The nine joints of one side, from the track to the wrist."""

    def joint(
        joint_name: str,
        kind: str,
        axis: Vector,
        links: tuple[str, str],
        pose: tuple[Vector, Vector],
        limits: Limits,
        motor: Motor,
    ) -> Joint:
        gear = abs(motor.gear)
        forwards, backwards = motor.coulomb if motor.gear > 0.0 else (-motor.coulomb[1], -motor.coulomb[0])
        resolution = 2.0 * pi / (counts * gear)
        return Joint(
            name=f"{name}_{joint_name}", kind=kind, axis=axis, parent=links[0], child=links[1], xyz=pose[0],
            rpy=pose[1], limits=limits, rotor_inertia=gear**2 * motor.inertia, viscous=gear**2 * motor.viscous,
            coulomb_positive=gear * forwards, coulomb_negative=-gear * backwards,
            brake=gear * motor.brake, resolution=resolution, noise=noise_counts * resolution,
        )  # fmt: skip

    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    links = [f"{name}_{link}" for link in CART_LINKS]
    up = [((0.0, 0.0, stage.height), ORIGIN) for stage in (cart.track, cart.rotation, cart.tilt)]
    yield joint("track", "prismatic", x, ("world", links[0]), up[0], side.track_limits, cart.track.motor)
    yield joint("rotation", "revolute", z, (links[0], links[1]), up[1], cart.rotation_limits, cart.rotation.motor)
    yield joint("tilt", "revolute", y, (links[1], links[2]), up[2], cart.tilt_limits, cart.tilt.motor)
    parent, pose = links[2], ((0.0, 0.0, arm.mount_height), ORIGIN)
    for number, (row, spec) in enumerate(zip(arm.links, arm.joints, strict=True), start=1):
        child = f"{name}_link{number}"
        yield joint(f"j{number}", "revolute", z, (parent, child), pose, spec.limits, spec.motor)
        parent, pose = child, far_end(row)


def links_of(name: str, cart: Cart, arm: ArmModel) -> Iterator[LinkInertia]:
    """The nine links with mass of one side, each the child of the joint of the same rank."""
    stages: tuple[CartStage, ...] = (cart.track, cart.rotation, cart.tilt)
    for link, stage in zip(CART_LINKS, stages, strict=True):
        yield LinkInertia(f"{name}_{link}", stage.mass, stage.com, ORIGIN, stage.inertia)
    for number, row in enumerate(arm.links, start=1):
        yield LinkInertia(f"{name}_link{number}", row.mass, _mass_centre(row), (row.alpha, 0.0, 0.0), row.inertia)


def far_end(row: DhLink) -> tuple[Vector, Vector]:
    """Pose of the DH frame in the URDF link's frame, as xyz [m] and rpy [rad].

    >>> far_end(cell.arm_models["puma_560"].links[1])
    ((0.4318, 0.0, 0.0), (0.0, 0.0, 0.0))
    """
    return (row.a, 0.0, row.d), (row.alpha, 0.0, 0.0)


def _mass_centre(row: DhLink) -> Vector:
    c, s = cos(row.alpha), sin(row.alpha)
    x, y, z = row.com
    return (row.a + x, c * y - s * z, row.d + s * y + c * z)
