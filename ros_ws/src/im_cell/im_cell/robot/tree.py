"""Joints and links of the cell as a tree, ready for physics and control."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np
from numpy.typing import NDArray

from im_cell.robot.description import MOVING, UrdfJoint, UrdfLink, UrdfTree
from im_cell.robot.parameters import Capsule, DriveSpec, EncoderSpec, Limits, Motor, Vector
from im_cell.rotations import matrix_of_rpy, matrix_of_vector, rpy_of_matrix

ORIGIN: Vector = (0.0, 0.0, 0.0)
WORLD = "world"
SPEED_TIME_S, ACCELERATION_TIME_S = 0.25, 0.1
"""Times to full speed and to full acceleration, where a cell has no limits of acceleration and jerk."""
FULL_TURNS, SLOW, GIVE = 2.0 * pi, 1.0, {"prismatic": 0.005}
"""Range of a joint without one [rad], speed [rad/s or m/s], and yield of a spring at full torque where no file says."""
FASTEST = 30.0
"""Speed of a joint [rad/s or m/s]: no arm is as fast, but one in degrees or millimetres seems to be."""
ROTOR, FRICTION = 125.0, 0.02
"""Acceleration of an assumed rotor alone under full torque [1/s2], and its frictions as a share of full torque."""
_ASSUMED_MOTOR = (
    f"a rotor that full torque accelerates by {ROTOR:g} /s2, dry and viscous friction of {100 * FRICTION:g} % of full "
    "torque each, and a brake of full torque"
)
_ENCODER_STEP = 1e-5
"""Resolution of an encoder where no motor is known [rad or m]."""


@dataclass(frozen=True)
class Joint:
    """A moving joint.

    Attributes:
        name: Its name.
        kind: ``prismatic`` or ``revolute``.
        axis: In the joint's frame.
        parent, child: The moving links on both sides, or ``world``.
        xyz, rpy: Pose of the joint in the parent's frame at position 0 [m, rad].
        limits: What must hold always.
        rotor_inertia: Reflected to the joint [kg m2 or kg].
        viscous: Reflected friction by speed [Nm s/rad or N s/m].
        coulomb_positive, coulomb_negative: Magnitudes of reflected dry friction by direction [Nm or N].
        brake: Reflected torque of the holding brake [Nm or N].
        resolution: Of the encoder [rad or m].
        noise: Standard deviation of the encoder before quantisation [rad or m].
        stiffness: Of a spring in its place, for joint impedance [Nm/rad or N/m].
        gear: How far the joint is off its encoder, coefficients of :func:`im_cell.robot.arm_errors.gear_waves` [rad].
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
    stiffness: float
    gear: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LinkInertia:
    """A link with mass, and all that is fixed to it.

    Attributes:
        name: Its name.
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


@dataclass(frozen=True)
class FixedFrame:
    """A link without a joint of its own that moves.

    Attributes:
        name: Its name.
        parent: The moving link that it is fixed to, or ``world``.
        xyz, rpy: Its pose there [m, rad].
    """

    name: str
    parent: str
    xyz: Vector
    rpy: Vector

    def matrices(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation, shape (3, 3), and translation, shape (3,) [m], from here to the parent."""
        return matrix_of_rpy(self.rpy), np.array(self.xyz)


class Tree:
    """The moving joints of a description, and the links fixed to others.

    Args:
        description: The robot.
        moving: Joints that move; all others stand where `standing` says, or at 0.
        standing: Positions of joints that do not move [rad or m].
        mount: Pose of the robot's root in the world [m, rad].

    Attributes:
        joints: Those that move, in order.
        frames: Links that are fixed to a moving link or to the world, by name.
    """

    def __init__(
        self,
        description: UrdfTree,
        moving: Iterable[str],
        standing: Mapping[str, float],
        mount: tuple[Vector, Vector],
    ) -> None:
        self.description = description
        self.moving = frozenset(moving)
        self.joints: list[tuple[UrdfJoint, FixedFrame]] = []
        self.frames: dict[str, FixedFrame] = {}
        places = {WORLD: FixedFrame(WORLD, WORLD, ORIGIN, ORIGIN)}
        if description.root != WORLD:
            places[description.root] = self.frames[description.root] = FixedFrame(description.root, WORLD, *mount)
        for joint in description.joints:
            where = _placed(joint.child, places[joint.parent], joint, standing.get(joint.name, 0.0))
            if joint.name in self.moving:
                self.joints.append((joint, where))
                places[joint.child] = FixedFrame(joint.child, joint.child, ORIGIN, ORIGIN)
            else:
                places[joint.child] = self.frames[joint.child] = where
        self._places = places

    def carrier(self, link: str) -> FixedFrame:
        """Return where a link is on the moving link that carries it; at the origin of itself, if it moves."""
        return self._places[link]

    @cached_property
    def links(self) -> tuple[LinkInertia, ...]:
        """Links with mass, fixed links included, each the child of the joint of the same rank."""
        bodies: dict[str, list[tuple[UrdfLink, FixedFrame]]] = {joint.child: [] for joint, _ in self.joints}
        for name, link in self.description.links.items():
            place = self._places[name]
            if place.parent in bodies and link.mass > 0.0:
                bodies[place.parent].append((link, place))
        return tuple(_body(name, parts) for name, parts in bodies.items())

    def on_carrier(self, capsule: Capsule) -> Capsule:
        """Return a capsule in the frame of the moving link that carries it."""
        place = self._places[capsule.link]
        if (place.xyz, place.rpy) == (ORIGIN, ORIGIN):
            return capsule.model_copy(update={"link": place.parent})
        rotation, origin = place.matrices()
        ends = {key: _vector(rotation @ getattr(capsule, key) + origin) for key in ("p0", "p1")}
        return capsule.model_copy(update={"link": place.parent, **ends})


def joint_of(joint: UrdfJoint, place: FixedFrame, drive: DriveSpec, encoder: EncoderSpec) -> Joint:
    """Return a moving joint with its drive; missing data are assumed (:func:`assumptions`).

    Raises:
        ValueError: The limit of velocity has another unit, it seems.
    """
    velocity = joint.velocity or SLOW
    if velocity > FASTEST:
        slides = joint.kind == "prismatic"
        does, unit, other = ("slides", "m", "millimetres") if slides else ("turns", "rad", "degrees")
        told = f"joint {joint.name} {does} at up to {velocity:g} {unit}/s"
        raise ValueError(f"{told}: its limit of velocity has {other}, it seems")
    lower, upper = joint.lower, joint.upper or 0.0
    if lower is None or joint.kind == "continuous":  # limits of such joints mean nothing, though files have them
        lower, upper = -FULL_TURNS, FULL_TURNS
    if drive.range is not None:
        lower, upper = drive.range
    acceleration = drive.acceleration or velocity / SPEED_TIME_S
    torque = joint.effort or drive.torque or 1.0
    limits = Limits(
        lower=lower, upper=upper, velocity=velocity, acceleration=acceleration,
        jerk=drive.jerk or acceleration / ACCELERATION_TIME_S, torque=torque,
    )  # fmt: skip
    stiffness = drive.stiffness or torque / GIVE.get(joint.kind, 0.05)
    motor = drive.motor or _motor(limits)
    gear = abs(motor.gear)
    forwards, backwards = motor.coulomb if motor.gear > 0.0 else (-motor.coulomb[1], -motor.coulomb[0])
    resolution = _ENCODER_STEP if drive.motor is None else 2.0 * pi / (encoder.counts_per_turn * gear)
    return Joint(
        name=joint.name, kind="prismatic" if joint.kind == "prismatic" else "revolute", axis=joint.axis,
        parent=place.parent, child=joint.child, xyz=place.xyz, rpy=place.rpy, limits=limits,
        rotor_inertia=gear**2 * motor.inertia, viscous=gear**2 * motor.viscous,
        coulomb_positive=gear * forwards, coulomb_negative=-gear * backwards,
        brake=gear * motor.brake, resolution=resolution, noise=encoder.noise_counts * resolution, stiffness=stiffness,
    )  # fmt: skip


def _motor(limits: Limits) -> Motor:
    """Return the motor of a joint without data, as in geared arms."""
    friction = FRICTION * limits.torque
    return Motor(
        inertia=limits.torque / ROTOR, gear=1.0, viscous=friction / limits.velocity, coulomb=(friction, -friction),
        brake=limits.torque,
    )  # fmt: skip


def assumptions(tree: Tree, drives: Mapping[str, DriveSpec]) -> tuple[list[str], list[str]]:
    """Return sentences on data missing in URDF and cell file: needed for torques, and others."""
    needed, other = [], []
    for joint in tree.description.joints:
        if joint.kind in MOVING and joint.name not in tree.moving:
            why = f", though it follows {joint.mimic}" if joint.mimic else ""
            other.append(f"joint {joint.name} is in no group and stands still{why}")
    lacking: dict[str, list[str]] = {}
    for joint, _ in tree.joints:
        drive = drives.get(joint.name, DriveSpec())
        if not joint.effort and drive.torque is None:
            needed.append(f"joint {joint.name} has no limit of effort")
        endless = drive.range is None and (joint.kind == "continuous" or joint.lower is None)
        for missing, assumed in (
            (endless, "no range; a turn to both sides"),
            (not joint.velocity, f"no limit of velocity; {SLOW:g} rad/s or m/s"),
            (drive.acceleration is None, f"no limit of acceleration; full speed after {SPEED_TIME_S:g} s"),
            (drive.jerk is None, f"no limit of jerk; full acceleration after {ACCELERATION_TIME_S:g} s"),
            (drive.motor is None, f"no motor; {_ASSUMED_MOTOR}"),
        ):
            if missing:
                lacking.setdefault(assumed, []).append(joint.name)
    other += [f"{', '.join(joints)}: {assumed}" for assumed, joints in lacking.items()]
    needed += [f"link {link.name} has no mass" for link in tree.links if link.mass == 0.0]
    return needed, other


def _placed(name: str, parent: FixedFrame, joint: UrdfJoint, position: float) -> FixedFrame:
    xyz, rpy = joint.xyz, joint.rpy
    if position:
        along = position * np.array(joint.axis)
        turn = matrix_of_rpy(rpy)
        if joint.kind == "prismatic":
            xyz = _vector(turn @ along + xyz)
        else:
            rpy = rpy_of_matrix(turn @ matrix_of_vector(along))
    if (parent.xyz, parent.rpy) == (ORIGIN, ORIGIN):
        return FixedFrame(name, parent.parent, xyz, rpy)
    rotation, origin = parent.matrices()
    return FixedFrame(
        name, parent.parent, _vector(rotation @ xyz + origin), rpy_of_matrix(rotation @ matrix_of_rpy(rpy))
    )


def _body(name: str, parts: list[tuple[UrdfLink, FixedFrame]]) -> LinkInertia:
    """Return links fixed to each other as one body, with principal inertias."""
    if not parts:
        return LinkInertia(name, 0.0, ORIGIN, ORIGIN, ORIGIN)
    if len(parts) == 1 and (parts[0][1].xyz, parts[0][1].rpy) == (ORIGIN, ORIGIN):
        link = parts[0][0]
        xx, xy, xz, yy, yz, zz = link.inertia
        if (xy, xz, yz) == (0.0, 0.0, 0.0):
            return LinkInertia(name, link.mass, link.com, link.rpy, (xx, yy, zz))
    mass = sum(link.mass for link, _ in parts)
    placed = []
    for link, place in parts:
        rotation, origin = place.matrices()
        xx, xy, xz, yy, yz, zz = link.inertia
        axes = rotation @ matrix_of_rpy(link.rpy)
        moments = axes @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axes.T
        placed.append((link.mass, rotation @ link.com + origin, moments))
    com = sum((m * c for m, c, _ in placed), np.zeros(3)) / mass
    whole = np.zeros((3, 3))
    for m, centre, moments in placed:
        d = centre - com
        whole += moments + m * (d @ d * np.eye(3) - np.outer(d, d))
    values, axes = np.linalg.eigh(whole)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return LinkInertia(name, mass, _vector(com), rpy_of_matrix(axes), _vector(values))


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
