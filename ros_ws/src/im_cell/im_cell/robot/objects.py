"""Free bodies of the cell: what lies on the table, and what grippers hold by contact and friction."""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from im_cell.robot.parameters import NonNegative, Place, Positive, Rpy, Size, Vector
from im_cell.robot.scenery import Target
from im_cell.rotations import matrix_of_quaternion, matrix_of_rpy, quaternion_of_matrix
from im_core.config import FieldError, Model

#: Most free bodies of a cell; the link to the testbed has room for them.
MAX_BODIES = 16


class FreeBody(Model):
    """Free body of the cell, homogeneous.

    Attributes:
        name: What it is.
        kind: ``box`` or ``cylinder``, upright along z.
        size: Edge lengths; of a cylinder diameter, diameter and height [m].
        mass: [kg].
        friction: Coefficient against a surface of coefficient 1; of two surfaces it is the product.
        color: Red, green, blue, 0 to 1.
        position: Of its middle in the world, at the start [m].
        rpy: Orientation there [rad].
        fiducial: Number of a code of OpenCV's dictionary 4X4_50 on its upper face; None: nothing is printed there.
        fiducial_size: Side of the code [m].
    """

    name: Annotated[str, Field(min_length=1, max_length=64)]
    kind: Literal["box", "cylinder"]
    size: Size
    mass: Positive
    friction: NonNegative = 0.6
    color: Vector
    position: Place
    rpy: Rpy = (0.0, 0.0, 0.0)
    fiducial: Annotated[int, Field(ge=0, lt=50)] | None = None
    fiducial_size: Positive = 0.04

    @model_validator(mode="after")
    def _has_shape(self) -> Self:
        if self.kind == "cylinder" and self.size[0] != self.size[1]:
            raise ValueError(f"a cylinder's size is diameter, diameter, height; the diameters of {self.size} differ")
        if self.fiducial is not None and self.fiducial_size > self.face:
            raise ValueError(f"fiducial_size {self.fiducial_size} is more than its face's {self.face} [m]")
        return self

    @property
    def face(self) -> float:
        """Side of the largest square on the upper face [m]."""
        return min(self.size[:2]) * (1.0 if self.kind == "box" else 0.5**0.5)

    def printed(self, pose: NDArray[np.float64]) -> Target | None:
        """Return the print on the upper face, if any.

        Args:
            pose: Of the body: position [m] and quaternion x, y, z, w, shape (7,).
        """
        if self.fiducial is None:
            return None
        axes = matrix_of_quaternion(pose[3:])
        top = pose[:3] + 0.5 * self.size[2] * axes[:, 2]
        return Target(
            name=self.name, kind="fiducial", id=self.fiducial, size=self.fiducial_size, plate=self.face,
            position=_vector(top), normal=_vector(axes[:, 2]), up=_vector(axes[:, 1]),
        )  # fmt: skip

    @property
    def start(self) -> NDArray[np.float64]:
        """Pose at the start: position [m] and quaternion x, y, z, w, shape (7,)."""
        return np.array([*self.position, *quaternion_of_matrix(matrix_of_rpy(self.rpy))])


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


class ObjectsFile(Model):
    """The free bodies and printed plates of a cell, in its own file or in one beside it.

    Attributes:
        objects: Free bodies.
        targets: Printed plates.
        board_poses: File of wrist poses that show the board on an arm to cameras; empty: there is none.
    """

    objects: Annotated[tuple[FreeBody, ...], Field(max_length=MAX_BODIES)] = ()
    targets: tuple[Target, ...] = ()
    board_poses: str = ""

    @field_validator("board_poses")
    @classmethod
    def _beside(cls, named: str, info: ValidationInfo) -> str:
        return str(Path(str((info.context or {}).get("file", ""))).parent / named) if named else ""

    @model_validator(mode="after")
    def _one_name_each(self) -> Self:
        for kind, parts in (("objects", self.objects), ("targets", self.targets)):
            names = [part.name for part in parts]
            for rank, name in enumerate(names):
                if name in names[:rank]:
                    raise FieldError((kind, rank, "name"), f"two {kind} have the same name, '{name}'")
        return self
