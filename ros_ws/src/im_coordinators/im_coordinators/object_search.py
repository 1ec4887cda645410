"""Search for a free body by the print on its upper face."""

import math

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell, FreeBody
from im_cell.rotations import cross_matrix
from im_core.errors import DataError, NotFoundError

#: A body that stands is upright within this [rad].
_UPRIGHT_RAD = math.radians(15.0)


def printed_body(cell: Cell, name: str) -> tuple[FreeBody, int]:
    """Return a free body of the cell and the number of its print.

    Raises:
        NotFoundError: There is none of the name.
        DataError: Nothing is printed on it.
    """
    bodies = {body.name: body for body in cell.objects}
    if name not in bodies:
        raise NotFoundError(kind="object", name=name, known=bodies)
    if (number := bodies[name].fiducial) is None:
        known = ", ".join(body.name for body in cell.objects if body.fiducial is not None)
        raise DataError(f"'{name}' has no fiducial by which it can be found; there are: {known}", object=name)
    return bodies[name], number


def standing_place(body: FreeBody, rotation: NDArray[np.float64], top: NDArray[np.float64]) -> tuple[float, ...]:
    """Return x, y, z of the middle of a body [m], and its turn about the vertical [rad].

    Of turns that look alike the smallest is taken: within an eighth of a turn for a square, a quarter for a rectangle.

    Args:
        body: The body.
        rotation: Rotation print -> world, shape (3, 3).
        top: Middle of the print in the world, shape (3,) [m].

    Raises:
        DataError: It does not stand upright.
    """
    tilt = math.acos(min(1.0, max(-1.0, float(rotation[2, 2]))))
    if tilt > _UPRIGHT_RAD:
        text = f"'{body.name}' leans by {math.degrees(tilt):.0f} degrees; only what stands is picked up"
        raise DataError(text, object=body.name, tilt=tilt)
    middle = top - 0.5 * body.size[2] * rotation[:, 2]
    same = math.pi / 2.0 if body.size[0] == body.size[1] else math.pi
    return *middle.tolist(), math.remainder(math.atan2(rotation[1, 0], rotation[0, 0]), same)


def middle_covariance(
    body: FreeBody, rotation: NDArray[np.float64], covariance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance of the middle of a body in the camera, from that of the print, shape (3, 3) [m^2].

    Args:
        body: The body.
        rotation: Rotation print -> camera, shape (3, 3).
        covariance: Of the middle of the print [m] and of a small rotation [rad], in the camera, shape (6, 6).
    """
    jacobian = np.hstack([np.eye(3), 0.5 * body.size[2] * cross_matrix(rotation[:, 2])])
    found: NDArray[np.float64] = jacobian @ covariance @ jacobian.T
    return found
