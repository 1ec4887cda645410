"""Scenery of the cameras beside robot and furniture: lenses, printed targets, mirroring metal, blinking lights."""

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from im_cell.robot.parameters import Mount, NonNegative, Place, Positive, Vector
from im_core.config import Model


class Optics(Model):
    """Lenses of the cameras.

    Attributes:
        blur: Standard deviation of the lens's blur [px].
        vignetting: Share of its brightness an image loses in its corners.
    """

    blur: Positive
    vignetting: Annotated[float, Field(ge=0.0, lt=1.0)]


class Target(Model):
    """Printed square plate, for cameras only: without collision.

    Attributes:
        name: Its name.
        kind: ``fiducial`` (black square with a code), ``circle`` (black disc), ``edge`` (its right half is black) or
            ``chessboard``.
        id: Number of the fiducial's code in OpenCV's dictionary 4X4_50.
        size: Side of the fiducial or of a chessboard's square, diameter of the disc, or length of the edge [m].
        corners: Columns and rows of a chessboard's inner corners.
        plate: Side of the white plate [m].
        parent: Frame it is fixed to, ``world`` or a link: an arm that carries a chessboard calibrates cameras with it.
        position: Its centre in that frame [m].
        normal: Direction it faces, in that frame.
        up: Direction of the print's upper side.
    """

    name: Annotated[str, Field(min_length=1, max_length=64)]
    kind: Literal["fiducial", "circle", "edge", "chessboard"]
    id: Annotated[int, Field(ge=0, lt=50)] = 0
    size: Positive
    corners: tuple[Annotated[int, Field(ge=2, le=50)], Annotated[int, Field(ge=2, le=50)]] = (8, 5)
    plate: Positive
    parent: str = "world"
    position: Place
    normal: Vector
    up: Vector

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (printed := self.size * (max(self.corners) + 1 if self.kind == "chessboard" else 1)) > self.plate:
            raise ValueError(f"size {printed:g} is more than the plate's {self.plate} [m]")
        if np.linalg.norm(np.cross(self.up, self.normal)) < 1e-6:
            raise ValueError(f"up {self.up} and normal {self.normal} are parallel")
        return self

    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return R, shape (3, 3), and t, shape (3,) [m]; ``x_parent = R x + t``: x to the right, y up, z out."""
        out = np.array(self.normal) / np.linalg.norm(self.normal)
        right = np.cross(np.array(self.up), out)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(out, right), out], axis=1), np.array(self.position)


class Mirror(Model):
    """Metal rectangle reflecting the lights.

    Attributes:
        name: What it is.
        link: Frame it is fixed to, ``world`` or a link.
        center: In the link's frame [m].
        axis: Direction it faces, along an axis of the link's frame.
        size: Edge lengths along the link's other two axes, in their order [m].
        reflectance: Share of the light that it reflects.
        roughness: Standard deviation that it adds to a reflected spot [px].
    """

    name: str
    link: str
    center: Place
    axis: Literal["x", "y", "z"]
    size: tuple[Positive, Positive]
    reflectance: Annotated[float, Field(ge=0.0, le=1.0)]
    roughness: NonNegative


class Lamp(Model):
    """Light with automatic blinking.

    Attributes:
        name: What it is.
        position: In the world [m].
        brightness: Relative to a wrist light.
        period: From one flash to the next [s] of testbed time.
        duty: Share of the period during which it is lit.
    """

    name: str
    position: Place
    brightness: NonNegative
    period: Positive
    duty: Annotated[float, Field(ge=0.0, le=1.0)]

    def lit(self, start_s: float, end_s: float) -> float:
        """Compute the share of a time interval [s] with the lamp lit; each flash starts at a multiple of the period."""

        def total(time_s: float) -> float:
            periods, rest = divmod(time_s, self.period)
            return periods * self.duty * self.period + min(rest, self.duty * self.period)

        return (total(end_s) - total(start_s)) / (end_s - start_s)


class LaserTolerance(Model):
    """Tolerances of a scanner around the data sheet, as standard deviations.

    Attributes:
        gain: Of a mirror's angle, relative [-].
        offset: Of mirror 1 [rad].
        gap: Of the mirrors' distance [m].
    """

    gain: Positive
    offset: Positive
    gap: Positive


class LaserScanner(Mount):
    """A laser scanner with two mirrors, as drawn; see :class:`im_cell.laser_model.LaserModel`.

    Attributes:
        position: Centre of mirror 2 in the world [m].
        target: Where the beam goes with both mirrors at zero [m].
        up: Together with the beam this gives the x axis, to the right of both.
        range: Largest angle of a mirror, to both sides [rad].
        rate: Largest speed of a mirror [rad/s].
        gap: Distance of the mirrors [m].
        repeatability: Standard deviation of where a mirror really comes to rest [rad].
        tolerance: How far the scanner may be off this data sheet.
        diameter: Of the beam [m].
        brightness: Of the spot on a white surface at full power, relative to a wrist light.
        speckle: Standard deviation of a pixel's brightness by speckle, relative to its mean.
    """

    range: Annotated[float, Field(gt=0.0, lt=0.5)]
    rate: Positive
    gap: Positive
    repeatability: NonNegative
    tolerance: LaserTolerance
    diameter: Positive
    brightness: Positive
    speckle: NonNegative

    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation scanner -> world, shape (3, 3), and position in the world, shape (3,) [m]."""
        return self.axes(), np.array(self.position)
