"""Lens models by name in `sensor_msgs/CameraInfo`: from ideal image points to distorted ones, and back.

Ideal points are on the plane z = 1 of the camera frame, so that a lens is described up to less than 90 degrees off its
axis, whatever its model.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ITERATIONS = 30
_TOLERANCE = 1e-13
_SOLVED = 1e-9
_WIDEST = np.deg2rad(89.9)
_ON_AXIS = 1e-12


COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""All names of coefficients; what one means is a matter of the model."""


class LensModel(ABC):
    """A lens model.

    Attributes:
        name: As `sensor_msgs/CameraInfo` names it.
        coefficients: Names of D, in order.
        estimated: How many of them a calibration estimates, from the first; the others are 0.
        powers: For each coefficient, the power of the angle off the axis with which its effect grows, relative to the
            angle itself.
    """

    name: str
    coefficients: tuple[str, ...]
    estimated: int
    powers: tuple[int, ...]

    def all_of(self, coefficients: ArrayLike) -> Array:
        """Return the full D from coefficients; trailing zeros, of terms never estimated, may be left out.

        Raises:
            DataError: There are too few or too many.
        """
        given, most = np.ravel(np.asarray(coefficients, dtype=float)), len(self.coefficients)
        if not self.estimated <= len(given) <= most:
            wanted = " or ".join(str(n) for n in range(self.estimated, most + 1))
            raise DataError(f"{self.name} has {wanted} coefficients, got {len(given)}", coefficients=len(given))
        everything = np.zeros(most)
        everything[: len(given)] = given
        return everything

    @abstractmethod
    def distort(self, xn: ArrayLike, D: ArrayLike) -> Array:
        """Distorted points, shape (..., 2) [-], of ideal points `xn`, shape (..., 2) [-]."""

    @abstractmethod
    def jacobian(self, xn: ArrayLike, D: ArrayLike) -> Array:
        """Derivative of :meth:`distort` by the ideal point, shape (..., 2, 2) [-]."""

    @abstractmethod
    def by_coefficients(self, xn: ArrayLike, D: ArrayLike, focal: tuple[float, float]) -> Array:
        """Derivative of the pixels by the coefficients, for fx and fy [px], shape (..., 2, len(D)) [px]."""

    @abstractmethod
    def inverse(self, xd: ArrayLike, D: ArrayLike) -> tuple[Array, Mask]:
        """Invert :meth:`distort` where the lens model can be inverted.

        Args:
            xd: Distorted points on the plane z = 1, shape (..., 2) [-].
            D: The coefficients.

        Returns:
            Ideal points, shape (..., 2) [-], and which of them are right, shape (...).
        """

    def undistort(self, xd: ArrayLike, D: ArrayLike) -> Array:
        """Invert :meth:`distort`.

        Args:
            xd: Distorted points on the plane z = 1, shape (..., 2) [-].
            D: The coefficients.

        Returns:
            Ideal points, shape (..., 2) [-].

        Raises:
            DataError: A point lies outside the part of the image where the lens model can be inverted.
        """
        points, solved = self.inverse(xd, D)
        if not np.all(solved):
            model = f"the lens model {self.name}, D = {np.asarray(D).tolist()},"
            raise DataError(f"{model} cannot be inverted at some of the given pixels")
        return points


class Brown(LensModel):
    """`plumb_bob` and `rational_polynomial`: radial polynomials and decentering, on the plane of the image.

    Source: Brown, "Decentering distortion of lenses" (1966), as in OpenCV; D = (k1, k2, p1, p2, k3, k4, k5, k6), of
    which `plumb_bob` has the first five, and a calibration estimates the first four.
    """

    _all_powers = (2, 4, 1, 1, 6, 2, 4, 6)

    def __init__(self, name: str, coefficients: int, estimated: int) -> None:
        """Create a model with the first coefficients of the list."""
        self.name, self.estimated = name, estimated
        self.coefficients = COEFFICIENTS[:coefficients]
        self.powers = self._all_powers[:coefficients]

    def distort(self, xn: ArrayLike, D: ArrayLike) -> Array:
        """Distorted points."""
        points, (_, _, p1, p2, *_) = np.asarray(xn, dtype=float), np.asarray(D, dtype=float)
        x, y = points[..., 0], points[..., 1]
        r2, xy = x * x + y * y, x * y
        radial, _, _ = self._radial(r2, D)
        xd = x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x * x)
        return np.stack((xd, y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * xy), axis=-1)

    def jacobian(self, xn: ArrayLike, D: ArrayLike) -> Array:
        """Derivative by the ideal point."""
        points, (_, _, p1, p2, *_) = np.asarray(xn, dtype=float), np.asarray(D, dtype=float)
        x, y = points[..., 0], points[..., 1]
        radial, slope, _ = self._radial(x * x + y * y, D)
        jacobian = np.empty((*points.shape[:-1], 2, 2))
        jacobian[..., 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        jacobian[..., 0, 1] = slope * (x * y) + 2.0 * p1 * x + 2.0 * p2 * y
        jacobian[..., 1, 0] = jacobian[..., 0, 1]
        jacobian[..., 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        return jacobian

    def by_coefficients(self, xn: ArrayLike, D: ArrayLike, focal: tuple[float, float]) -> Array:
        """Derivative of the pixels by the coefficients."""
        points, (fx, fy) = np.asarray(xn, dtype=float), focal
        x, y = points[..., 0], points[..., 1]
        r2, xy = x * x + y * y, x * y
        radial, _, below = self._radial(r2, D)
        found = np.empty((*points.shape[:-1], 2, 8))
        u, v = fx * x * r2 / below, fy * y * r2 / below
        for k, factor in ((0, 1.0), (1, r2), (4, r2 * r2)):
            found[..., 0, k], found[..., 1, k] = u * factor, v * factor
        found[..., 5:] = -radial[..., None, None] * found[..., (0, 1, 4)]
        found[..., 0, 2], found[..., 1, 2] = fx * 2.0 * xy, fy * (r2 + 2.0 * y * y)
        found[..., 0, 3], found[..., 1, 3] = fx * (r2 + 2.0 * x * x), fy * 2.0 * xy
        return found[..., : len(self.coefficients)]

    def inverse(self, xd: ArrayLike, D: ArrayLike) -> tuple[Array, Mask]:
        """Invert by Newton's method."""
        target = np.asarray(xd, dtype=float)
        guess = target.copy()
        with np.errstate(all="ignore"):
            for _ in range(_ITERATIONS):
                residual = self.distort(guess, D) - target
                if np.all(np.abs(residual) < _TOLERANCE):
                    break
                (a, b), (_, c) = np.moveaxis(self.jacobian(guess, D), (-2, -1), (0, 1))  # no number is left on the fold
                u, v = np.moveaxis(residual, -1, 0) / (a * c - b * b)
                guess = guess - np.stack((c * u - b * v, a * v - b * u), axis=-1)
            solved = np.all(np.abs(self.distort(guess, D) - target) < _SOLVED, axis=-1)
            return guess, np.asarray(solved & self._before_the_fold(guess, D))

    def _radial(self, r2: Array, D: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the radial factor, twice the derivative by `r2`, and the denominator of the factor."""
        k1, k2, _, _, k3, *rest = np.asarray(D, dtype=float).tolist()
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        above_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
        if not rest:
            return radial, 2.0 * above_slope, np.ones(())
        k4, k5, k6 = rest
        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        below_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)
        return radial, 2.0 * ((above_slope - radial * below_slope) / below), below

    def _before_the_fold(self, xn: Array, D: ArrayLike) -> Mask:
        """Whether ideal points, shape (..., 2), lie where the image of the lens does not run backwards."""
        radial, _, below = self._radial((xn**2).sum(axis=-1), D)
        return np.asarray((radial > 0.0) & (below > 0.0) & (np.linalg.det(self.jacobian(xn, D)) > 0.0))


class Equidistant(LensModel):
    """`equidistant`: the distance from the axis in the image is a polynomial of the angle off the axis; for fisheyes.

    Source: Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
    fish-eye lenses" (2006), as in OpenCV's fisheye; D = (k1, k2, k3, k4).
    """

    name = "equidistant"
    coefficients = ("k1", "k2", "k3", "k4")
    estimated = 4
    powers = (2, 4, 6, 8)

    def distort(self, xn: ArrayLike, D: ArrayLike) -> Array:
        """Distorted points."""
        points = np.asarray(xn, dtype=float)
        _, scale, _ = self._scale(points, D)
        return np.asarray(points * scale[..., None])

    def jacobian(self, xn: ArrayLike, D: ArrayLike) -> Array:
        """Derivative by the ideal point."""
        points = np.asarray(xn, dtype=float)
        _, scale, bend = self._scale(points, D)
        outer = points[..., :, None] * points[..., None, :]
        return np.asarray(scale[..., None, None] * np.eye(2) + bend[..., None, None] * outer)

    def by_coefficients(self, xn: ArrayLike, D: ArrayLike, focal: tuple[float, float]) -> Array:
        """Derivative of the pixels by the coefficients."""
        points = np.asarray(xn, dtype=float)
        theta, _, _ = self._scale(points, D)
        pixels = points * self._over_radius(points, theta)[..., None] * np.array(focal)
        return np.asarray(pixels[..., None] * theta[..., None, None] ** np.array([2, 4, 6, 8]))

    def inverse(self, xd: ArrayLike, D: ArrayLike) -> tuple[Array, Mask]:
        """Invert by Newton's method on the angle."""
        target = np.asarray(xd, dtype=float)
        radius = np.linalg.norm(target, axis=-1)
        theta = np.minimum(radius, 1.2)
        with np.errstate(all="ignore"):
            for _ in range(_ITERATIONS):
                angle, slope = self._polynomial(theta, D)
                if np.all(np.abs(angle - radius) < _TOLERANCE):
                    break
                theta = theta - (angle - radius) / slope
            angle, slope = self._polynomial(theta, D)
            solved = (np.abs(angle - radius) < _SOLVED) & (slope > 0.0) & (theta >= 0.0) & (theta < _WIDEST)
        scale = np.where(radius > _ON_AXIS, np.tan(theta) / np.maximum(radius, _ON_AXIS), 1.0)
        return np.asarray(target * scale[..., None]), np.asarray(solved)

    def _scale(self, points: Array, D: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the angle off axis, the factor on ideal points, and the derivative by the radius over the radius."""
        r2 = (points**2).sum(axis=-1)
        theta = np.arctan(np.sqrt(r2))
        angle, slope = self._polynomial(theta, D)
        safe = np.maximum(r2, _ON_AXIS)
        near = r2 < _ON_AXIS
        scale = np.where(near, 1.0, angle / np.sqrt(safe))
        k1 = float(np.asarray(D, dtype=float)[0])
        bend = np.where(near, 2.0 * (k1 - 1.0 / 3.0), (slope / (1.0 + r2) - scale) / safe)
        return theta, scale, bend

    def _over_radius(self, points: Array, theta: Array) -> Array:
        r2 = (points**2).sum(axis=-1)
        return np.asarray(np.where(r2 < _ON_AXIS, 1.0, theta / np.sqrt(np.maximum(r2, _ON_AXIS))))

    def _polynomial(self, theta: Array, D: ArrayLike) -> tuple[Array, Array]:
        """Return the distance from the axis in the image [focal lengths], and the derivative by the angle."""
        k1, k2, k3, k4 = np.asarray(D, dtype=float)
        t2 = theta * theta
        angle = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        return angle, 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))


PLUMB_BOB = Brown("plumb_bob", 5, 4)
RATIONAL_POLYNOMIAL = Brown("rational_polynomial", 8, 8)
EQUIDISTANT = Equidistant()

LENSES: Mapping[str, LensModel] = {lens.name: lens for lens in (PLUMB_BOB, RATIONAL_POLYNOMIAL, EQUIDISTANT)}
"""Lens models by name."""


def lens_of(name: str) -> LensModel:
    """The lens model of a name.

    Raises:
        DataError: There is none.
    """
    if name not in LENSES:
        raise DataError(f"lens model '{name}' is unknown, it must be one of {', '.join(LENSES)}", model=name)
    return LENSES[name]
