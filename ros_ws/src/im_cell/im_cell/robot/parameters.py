"""Typed contents of ``cell.yaml``; SI units, radians."""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, field_validator, model_validator

from im_core.config import FieldError, Model

_LARGEST = 1e9
"""Of any number; no cell has one near it, and products of them are numbers still."""
Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
Positive = Annotated[float, Field(gt=0.0, le=_LARGEST)]
NonNegative = Annotated[float, Field(ge=0.0, le=_LARGEST)]
ToolPose = tuple[Number, Number, Number, Number, Number, Number, Number]
Source = Annotated[str, Field(min_length=1)]


Vector = tuple[Number, Number, Number]
LARGEST_M, _MOST_RPY = 50.0, 7.0


def require_metres(place: Vector) -> Vector:
    """Refuse a place or a size in millimetres: no cell is as large as that.

    Raises:
        ValueError: A number is beyond what a cell has.
    """
    if (far := max(place, key=abs)) > LARGEST_M or far < -LARGEST_M:
        raise ValueError(f"{far:g} m is beyond {LARGEST_M:g} m: lengths are millimetres, it seems")
    return place


def require_radians(rpy: Vector) -> Vector:
    """Refuse an orientation in degrees: roll, pitch and yaw [rad] of no file go beyond a full turn.

    Raises:
        ValueError: An angle does.
    """
    if (most := max(rpy, key=abs)) > _MOST_RPY or most < -_MOST_RPY:
        raise ValueError(f"it is turned by {most:g} rad: angles are degrees, it seems")
    return rpy


Place = Annotated[Vector, AfterValidator(require_metres)]
Size = Annotated[tuple[Positive, Positive, Positive], AfterValidator(require_metres)]
Rpy = Annotated[Vector, AfterValidator(require_radians)]

MOST_CORNERS, THINNEST_M = 64, 1e-4
_LEAST_GEAR, _MOST_PIXELS = 1e-6, 10_000
_SAME_M, _PARALLEL, _UNIT = 1e-9, 1e-6, 1e-3


class Limits(Model):
    """Limits of a joint.

    Attributes:
        lower, upper: Range [rad or m].
        velocity, acceleration, jerk: Largest magnitudes, by s, s2, s3.
        torque: Largest motor torque at the joint [Nm or N].
    """

    lower: Number
    upper: Number
    velocity: Positive
    acceleration: Positive
    jerk: Positive
    torque: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.lower >= self.upper:
            raise ValueError(f"lower {self.lower} is not < upper {self.upper}")
        return self


class Motor(Model):
    """Motor behind a gear, in the motor's own terms.

    Attributes:
        inertia: Of the rotor [kg m2].
        gear: Motor turns per joint turn, negative if they turn opposite ways [1 or rad/m].
        viscous: Friction by speed [Nm s].
        coulomb: Friction torque turning forwards (> 0) and backwards (< 0) [Nm].
        brake: Torque of the holding brake on the motor's shaft [Nm].
    """

    inertia: NonNegative
    gear: Number
    viscous: NonNegative
    coulomb: tuple[NonNegative, Annotated[float, Field(le=0.0, ge=-_LARGEST)]]
    brake: NonNegative

    @field_validator("gear")
    @classmethod
    def _turns(cls, gear: float) -> float:
        if not _LEAST_GEAR <= abs(gear) <= 1.0 / _LEAST_GEAR:
            raise ValueError(f"{gear} is no gear: its size is {_LEAST_GEAR:g} to {1.0 / _LEAST_GEAR:g}")
        return gear


class Capsule(Model):
    """A cylinder with round ends, for collision and display.

    Attributes:
        link: URDF link it is fixed to.
        p0, p1: Ends of its axis in the link's frame [m].
        radius: [m].
        visual: Whether it is drawn.
    """

    link: str
    p0: Place
    p1: Place
    radius: Positive
    visual: bool = True


class Hull(Model):
    """The convex hull of points, with a margin around: closer to a mesh than a capsule, for collision alone.

    Attributes:
        link: URDF link it is fixed to.
        points: Corners in the link's frame, not all in one plane [m].
        radius: Margin around [m].
    """

    link: str
    points: Annotated[tuple[Place, ...], Field(min_length=4, max_length=MOST_CORNERS)]
    radius: NonNegative

    @field_validator("points")
    @classmethod
    def _solid(cls, points: tuple[Vector, ...]) -> tuple[Vector, ...]:
        if thickness(np.array(points)) < THINNEST_M:
            raise ValueError(
                f"these points are in one plane, or nearly: a hull is {1e3 * THINNEST_M:g} mm thick or more"
            )
        return points


def thickness(points: NDArray[np.float64]) -> float:
    """Return the least extent of points along their principal axes [m].

    Args:
        points: Shape (n, 3) [m].
    """
    if len(points) < 4:
        return 0.0
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    return float(np.ptp(centred @ axes.T, axis=0).min())


class Box(Model):
    """Box for display, and for collision where fixed to the world.

    Attributes:
        link: URDF link it is fixed to.
        name: What it is.
        size: Edge lengths [m].
        center: In the link's frame [m].
        color: Red, green, blue, 0 to 1.
        collision: Whether it is an obstacle.
    """

    link: str
    name: str
    size: Size
    center: Place
    color: Vector
    collision: bool = True


class DriveSpec(Model):
    """Drive of a joint: data that URDF has no words for.

    Attributes:
        acceleration, jerk: Largest magnitudes, by s2, s3; None: full speed and full acceleration take a stated time.
        torque: Largest motor torque, where the URDF has none [Nm or N].
        range: Range, where the URDF has none or a wider one [rad or m].
        motor: Motor behind a gear; None: one of the order of those of geared arms, see :mod:`im_cell.robot.tree`.
        stiffness: For joint impedance [Nm/rad or N/m]; None: full torque at 0.05 rad or 5 mm.
    """

    acceleration: Positive | None = None
    jerk: Positive | None = None
    torque: Positive | None = None
    range: tuple[Number, Number] | None = None
    motor: Motor | None = None
    stiffness: Positive | None = None


class CellGroup(Model):
    """Chain of joints that ends in a tool frame, with the devices mounted there.

    Attributes:
        tip: Frame of the tool, the last link as a rule.
        base: Link that the arm stands on; joints below it carry the arm.
        joints: Names; empty: all joints from the world to the tip.
        home: Position of each joint at the start [rad or m].
        color: Red, green, blue of its links, 0 to 1.
        gripper, force, light: Whether it has a gripper, a force-torque sensor, a light.
        source: Origin of the numbers, by what they are of: first the arm, then what carries it.
    """

    tip: str
    base: str = "world"
    joints: tuple[str, ...] = ()
    home: tuple[Number, ...]
    color: Vector = (0.72, 0.73, 0.75)
    gripper: bool = False
    force: bool = False
    light: bool = False
    source: dict[str, Source] = Field(default_factory=dict)


class Group(Model):
    """Slots moving together."""

    joints: tuple[str, ...] = Field(min_length=1)
    wrist: str | None = Field(default=None, description="frame whose pose the group controls, if it has one")
    pair: tuple[str, str] | None = Field(
        default=None, description="two wrists, in place of one: on straight lines of the first the second goes along"
    )

    @property
    def frames(self) -> tuple[str, ...]:
        """Wrists that straight lines move: none, one, or the pair."""
        return self.pair or (() if self.wrist is None else (self.wrist,))

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.wrist is not None and self.pair is not None:
            raise ValueError("a group has a wrist or a pair of wrists, not both")
        return self


class CellMount(Model):
    """Pose of the URDF's root in the world [m, rad]."""

    xyz: Place = (0.0, 0.0, 0.0)
    rpy: Rpy = (0.0, 0.0, 0.0)


class EncoderSpec(Model):
    """Encoders, on the motor shafts."""

    counts_per_turn: Annotated[int, Field(gt=0)]
    noise_counts: NonNegative


class BrakeSpec(Model):
    """The holding brakes of all joints; ``source``: origin of the numbers, or a note of estimates.

    Attributes:
        delay: Time from a command, or the loss of power, until a brake holds or lets go [s].
    """

    source: Source
    delay: NonNegative


class SensorSpec(Model):
    """A sensor of forces or torques: standard deviations of noise and bias, step and range of readings [N or Nm]."""

    noise: NonNegative
    bias: NonNegative
    resolution: Positive
    range: Positive


class Gripper(Model):
    """A pneumatic gripper.

    Attributes:
        stroke: Largest opening [m].
        rate: Speed of the jaws [m/s].
        initial: Opening at the start [m].
        force: Largest force between the jaws [N].
        reach: From the wrist frame along its z axis to the middle of the jaws [m].
        palm, jaw: Edge lengths of the body and of a jaw in the axes of the wrist frame, jaws open along x [m].
        force_sensor: Between the jaws.
        jaw_mass: Of each jaw, in cells with free bodies [kg].
    """

    stroke: Positive = 0.08
    rate: Positive = 0.25
    initial: NonNegative = 0.08
    force: Positive = 120.0
    reach: NonNegative = 0.15
    palm: Size = (0.10, 0.04, 0.09)
    jaw: Size = (0.012, 0.024, 0.06)
    force_sensor: SensorSpec = SensorSpec(noise=0.2, bias=0.0, resolution=0.1, range=250.0)
    jaw_mass: Positive = 0.03

    @model_validator(mode="after")
    def _opens(self) -> Self:
        if self.initial > self.stroke:
            raise FieldError(("initial",), f"{self.initial} is more than the stroke, {self.stroke} [m]")
        return self


class WristSensor(Model):
    """The six-axis sensor of a wrist; ``source`` as of the brakes."""

    source: Source = "assumed"
    force: SensorSpec = SensorSpec(noise=0.05, bias=0.5, resolution=0.025, range=200.0)
    torque: SensorSpec = SensorSpec(noise=0.002, bias=0.02, resolution=0.001, range=15.0)


class Led(Model):
    """A wrist light: nominal offset and outward axis in the wrist frame [m], diameter [m], half angle [rad].

    `offset_prior_sd` is the standard deviation of each axis of the true offset [m]; 0: the nominal one is exact.
    """

    offset: Place = (0.0, 0.06, 0.05)
    offset_prior_sd: NonNegative = 0.005
    axis: Vector = (0.0, 1.0, 0.0)
    diameter: Positive = 0.02
    half_angle: Positive = 1.75

    @model_validator(mode="after")
    def _shines(self) -> Self:
        if np.linalg.norm(self.axis) < _SAME_M:
            raise FieldError(("axis",), f"{self.axis} has no direction")
        return self


class Intrinsics(Model):
    """A pinhole camera: image size, focal lengths, principal point [px]."""

    width: Annotated[int, Field(gt=0, le=_MOST_PIXELS)]
    height: Annotated[int, Field(gt=0, le=_MOST_PIXELS)]
    fx: Positive
    fy: Positive
    cx: Number
    cy: Number


class Mount(Model):
    """Mount of a device at ``position`` [m], looking at ``target`` [m], with ``up`` as top of its view."""

    position: Place
    target: Place
    up: Vector

    @model_validator(mode="after")
    def _has_axes(self) -> Self:
        self.axes()
        return self

    def axes(self) -> NDArray[np.float64]:
        """Compute right, down and forward in the frame of the mount, as columns, shape (3, 3).

        Raises:
            ValueError: The target is at the position, or ``up`` is along the view.
        """
        forward = np.array(self.target) - np.array(self.position)
        distance, length = np.linalg.norm(forward), np.linalg.norm(self.up)
        if distance < _SAME_M or length < _SAME_M:
            text = (
                f"target {self.target} and position {self.position} must differ [m], and up {self.up} must not be zero"
            )
            raise ValueError(text)
        forward /= distance
        right = np.cross(forward, np.array(self.up) / length)
        if (across := np.linalg.norm(right)) < _PARALLEL:
            raise ValueError(f"up, {self.up}, is along its view, from {self.position} to {self.target}")
        right /= across
        return np.stack([right, np.cross(forward, right), forward], axis=1)


class CameraCheck(Model):
    """How to find out whether a camera on an arm was moved, while that arm is at home.

    Attributes:
        arm: Group whose light the camera is shown.
        shown: Where the tool of that group is in two looks: position [m] and unit quaternion x, y, z, w in the world.
        poses: ``poses_file`` of ``calibrate_camera`` for this camera.
    """

    arm: str
    shown: tuple[ToolPose, ToolPose]
    poses: Annotated[str, Field(min_length=1)]

    @field_validator("shown")
    @classmethod
    def _unit(cls, poses: tuple[ToolPose, ToolPose]) -> tuple[ToolPose, ToolPose]:
        for pose in poses:
            if abs((length := float(np.linalg.norm(pose[3:]))) - 1.0) > _UNIT:
                raise ValueError(f"the quaternion {pose[3:]} has length {length:.4f}; it must be 1")
        return poses


class Camera(Mount):
    """Nominal mount and lens of a camera; how it is checked, where it rides on an arm."""

    parent: str
    intrinsics: Intrinsics
    check: CameraCheck | None = None

    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Nominal R, shape (3, 3), and t, shape (3,) [m], with ``x_optical = R x_parent + t``."""
        rotation = self.axes().T
        return rotation, -rotation @ np.array(self.position)
