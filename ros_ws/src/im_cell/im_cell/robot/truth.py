"""True values of the simulated cell, as the file ``truth.json``.

Written by the testbed; read by what plays hardware (the camera process) and, after calibration is done, by whoever
prints its error. Nothing that estimates may read it.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from im_cell.laser_model import LaserModel
from im_cell.robot.arm_errors import kinematic_derivatives, usual_errors
from im_cell.robot.cell import Cell
from im_cell.robot.parameters import Positive, Vector
from im_cell.robot.tree import ORIGIN, Joint
from im_cell.rotations import matrix_of_rpy, matrix_of_vector, rpy_of_matrix
from im_core.config import Model, faults
from im_core.errors import DataError
from im_core.text.jsontext import load_json

FILE_NAME = "truth.json"
Array = NDArray[np.float64]
_PLACES = 20
Matrix = tuple[Vector, Vector, Vector]


class CameraTruth(Model):
    """A camera.

    Attributes:
        parent: Frame it is fixed to, ``world`` (the base) or a link.
        width, height: Image size [px].
        K: Intrinsics [px].
        D: Distortion k1, k2, p1, p2, k3.
        R_cam_base, t_cam_base_m: Pose, ``x_cam = R x_parent + t`` [m].
    """

    parent: str
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    K: Matrix
    D: Annotated[tuple[float, ...], Field(min_length=5, max_length=5)]
    R_cam_base: Matrix
    t_cam_base_m: Vector


class LedTruth(Model):
    """Wrist light: offset and outward axis in the frame of the wrist [m], diameter [m]."""

    offset_m: Vector
    axis: Vector
    diameter_m: Positive


class LaserTruth(Model):
    """The laser scanner, see :class:`im_cell.laser_model.LaserModel`.

    Attributes:
        rotation, position_m: Pose, ``x_world = R x_scanner + t`` [m].
        gain: Of the mirrors' angles [-].
        offset: Of mirror 1 [rad].
        gap_m: Between the mirrors [m].
    """

    rotation: Matrix
    position_m: Vector
    gain: tuple[float, float]
    offset: float
    gap_m: Positive

    def model(self) -> LaserModel:
        """How the beam really goes."""
        return LaserModel(np.array(self.rotation), np.array(self.position_m), self.gap_m, self.gain, self.offset)


class JointTruth(Model):
    """Joint off the drawing.

    Attributes:
        turn_rad, shift_m: Of the joint in its own frame, as :func:`im_cell.robot.kinematic_derivatives` has them.
        gear_rad: How far the joint is off its encoder, by :func:`im_cell.robot.arm_errors.gear_waves`.
    """

    turn_rad: Vector
    shift_m: Vector
    gear_rad: tuple[float, float, float, float]

    @classmethod
    def of(cls, drawn: Joint, errors: Array) -> Self:
        """Return a joint with errors in units of the usual sizes, shape (6,) or (10,) [-]."""
        sizes = np.append(errors * usual_errors(drawn), np.zeros(4))[:10].tolist()
        return cls.model_validate({"turn_rad": sizes[:3], "shift_m": sizes[3:6], "gear_rad": sizes[6:]})

    def errors(self, drawn: Joint) -> Array:
        """Return the inverse of :meth:`of`."""
        usual = usual_errors(drawn)
        return np.array((*self.turn_rad, *self.shift_m, *self.gear_rad))[: len(usual)] / usual

    def built(self, drawn: Joint) -> Joint:
        """Return the true joint."""
        stand = matrix_of_rpy(drawn.rpy)
        x, y, z = (stand @ self.shift_m + drawn.xyz).tolist()
        rpy = rpy_of_matrix(stand @ matrix_of_vector(np.array(self.turn_rad)))
        return replace(drawn, xyz=(x, y, z), rpy=rpy, gear=self.gear_rad)


def errors_of(cell: Cell, frame: str, joints: Mapping[str, JointTruth]) -> Array:
    """Return the errors of the joints below a frame, in the order of :func:`im_cell.robot.kinematic_derivatives`.

    Returns:
        In units of their usual sizes, shape (k,) [-].
    """
    drawn = {joint.name: joint for joint in cell.joints}
    below = [drawn[name] for name in cell.carriers_of(frame) if name in drawn]
    perfect = JointTruth(turn_rad=ORIGIN, shift_m=ORIGIN, gear_rad=(0.0, 0.0, 0.0, 0.0))
    return np.concatenate([joints.get(joint.name, perfect).errors(joint) for joint in below])


def tool_errors(cell: Cell, group: str, joints: Mapping[str, JointTruth], rng: np.random.Generator) -> Array:
    """Return the distances of a group's tool from the drawn places, at random positions of the joints below.

    Args:
        cell: The cell as drawn.
        group: Name of the group.
        joints: Joints off their drawing, by name.
        rng: Of the places.

    Returns:
        Shape (20,) [m].
    """
    tip, tool = cell.groups[group].tip, np.array((0.0, 0.0, cell.reach_of(group)))
    below = [joint for joint in cell.joints if joint.name in cell.carriers_of(tip)]
    ranges = {joint.name: (joint.limits.lower, joint.limits.upper) for joint in below}
    at = [{name: rng.uniform(*ends) for name, ends in ranges.items()} for _ in range(_PLACES)]
    errors = errors_of(cell, tip, joints)
    return np.array([np.linalg.norm(kinematic_derivatives(cell, tip, each, tool) @ errors) for each in at])


class CellTruth(Model):
    """True cameras and lights by name, the laser scanner if there is one, and the random seed of all.

    Attributes:
        joints: Joints off their drawing, by name; others are as drawn.
        objects: Present poses of the free bodies: position [m] and quaternion x, y, z, w; only where the testbed is
            asked.
    """

    seed: int
    cameras: dict[str, CameraTruth]
    leds: dict[str, LedTruth]
    laser: LaserTruth | None
    joints: dict[str, JointTruth] = Field(default_factory=dict)
    objects: dict[str, tuple[float, ...]] = Field(default_factory=dict)

    def built(self, cell: Cell) -> Cell:
        """Return the cell with the true joints."""
        joints = (self.joints[each.name].built(each) if each.name in self.joints else each for each in cell.joints)
        return cell.model_copy(update={"joints": tuple(joints)})


def load_truth(path: Path) -> CellTruth:
    """Read a truth file.

    Raises:
        DataError: It is missing or malformed.
    """
    try:
        return CellTruth.model_validate(load_json(path))
    except ValidationError as error:
        fault = faults(error, CellTruth)[0]
        raise DataError(f"{path}: is not a truth file: {fault.field}: {fault.sentence}", file=str(path)) from error
