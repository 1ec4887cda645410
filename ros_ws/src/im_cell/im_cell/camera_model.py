"""Pinhole camera with `plumb_bob` lens distortion and a pose in the world.

Conventions (OpenCV and REP-105): ``x_cam = R_cam_base @ x_world + t_cam_base``; z forward, x right, y down; the centre
of the upper left pixel is (0, 0); D = (k1, k2, p1, p2, k3).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]

_PINHOLE = ("fx", "fy", "cx", "cy")
_POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
PARAMETERS = (*_PINHOLE, "k1", "k2", "p1", "p2", "k3", *_POSE)
"""What describes a camera: pinhole [px], lens [-], turn in the camera frame [rad], shift [m]."""
POSE_PARAMETERS = len(_POSE)
"""How many of them, the last ones, are the pose."""
_LENS_STEP = 1e-5
"""Of central differences by the lens, in which an image is linear or nearly so."""

_UNDISTORT_ITERATIONS = 30
_UNDISTORT_TOLERANCE = 1e-13


def distort(xn: ArrayLike, D: ArrayLike) -> Array:
    """Apply the `plumb_bob` lens to ideal image points.

    Args:
        xn: Ideal points on the plane z = 1, shape (..., 2) [-].
        D: Distortion k1, k2, p1, p2, k3, shape (5,) [-].

    Returns:
        Distorted points, shape (..., 2) [-]. Source: Brown, "Decentering distortion of lenses" (1966), as in OpenCV.
    """
    points = np.asarray(xn, dtype=float)
    k1, k2, p1, p2, k3 = np.asarray(D, dtype=float)
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ),
        axis=-1,
    )


def distort_jacobian(xn: ArrayLike, D: ArrayLike) -> Array:
    """Derivative of :func:`distort` with respect to the ideal point.

    Args:
        xn: Ideal points, shape (..., 2) [-].
        D: Distortion k1, k2, p1, p2, k3, shape (5,) [-].

    Returns:
        Jacobians, shape (..., 2, 2) [-].
    """
    points = np.asarray(xn, dtype=float)
    k1, k2, p1, p2, k3 = np.asarray(D, dtype=float)
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d(radial)/d(r2) * 2
    jacobian = np.empty((*points.shape[:-1], 2, 2))
    jacobian[..., 0, 0] = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    jacobian[..., 0, 1] = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    jacobian[..., 1, 0] = jacobian[..., 0, 1]
    jacobian[..., 1, 1] = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return jacobian


def undistort(xd: ArrayLike, D: ArrayLike) -> Array:
    """Invert :func:`distort` by Newton's method.

    Args:
        xd: Distorted points on the plane z = 1, shape (..., 2) [-].
        D: Distortion k1, k2, p1, p2, k3, shape (5,) [-].

    Returns:
        Ideal points, shape (..., 2) [-].

    Raises:
        DataError: A point lies outside the part of the image where the lens model can be inverted.
    """
    target = np.asarray(xd, dtype=float)
    guess = target.copy()
    with np.errstate(all="ignore"):
        for _ in range(_UNDISTORT_ITERATIONS):
            residual = distort(guess, D) - target
            if np.all(np.abs(residual) < _UNDISTORT_TOLERANCE):
                break
            try:
                guess = guess - np.linalg.solve(distort_jacobian(guess, D), residual[..., None])[..., 0]
            except np.linalg.LinAlgError:
                break  # on the fold: refused below
        solved = np.all(np.abs(distort(guess, D) - target) < 1e-9, axis=-1)
        if np.all(solved & _before_the_fold(guess, D)):
            return guess
    raise DataError(f"the lens model D = {np.asarray(D).tolist()} cannot be inverted at some of the given pixels")


def _before_the_fold(xn: Array, D: ArrayLike) -> NDArray[np.bool_]:
    """Whether ideal points, shape (..., 2), lie where the image of the lens does not run backwards."""
    k1, k2, _, _, k3 = np.asarray(D, dtype=float)
    r2 = (xn**2).sum(axis=-1)
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.asarray((radial > 0.0) & (np.linalg.det(distort_jacobian(xn, D)) > 0.0))


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics, lens and pose of one camera.

    Attributes:
        width: Image width [px].
        height: Image height [px].
        K: Camera matrix, shape (3, 3) [px].
        D: `plumb_bob` distortion k1, k2, p1, p2, k3, shape (5,) [-].
        R_cam_base: Rotation world -> camera, shape (3, 3) [-].
        t_cam_base: Origin of the world in the camera frame, shape (3,) [m].
    """

    width: int
    height: int
    K: Array
    D: Array
    R_cam_base: Array = field(default_factory=lambda: np.eye(3))
    t_cam_base: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        """Check shapes and values.

        Raises:
            DataError: A matrix has the wrong shape, is not finite, or is not a camera matrix or a rotation.
        """
        shapes = {"K": (3, 3), "D": (5,), "R_cam_base": (3, 3), "t_cam_base": (3,)}
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise DataError(f"{name} of a camera has shape {value.shape}, it must be {shape}.")
            if not np.all(np.isfinite(value)):
                raise DataError(f"{name} of a camera holds a value that is not finite.")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.width < 1 or self.height < 1:
            raise DataError(f"The image of a camera is {self.width} x {self.height} px, both must be at least 1.")
        if self.K[0, 0] <= 0.0 or self.K[1, 1] <= 0.0:
            raise DataError(f"The focal lengths of a camera are {self.K[0, 0]}, {self.K[1, 1]} px, they must be > 0.")
        if np.abs(self.R_cam_base @ self.R_cam_base.T - np.eye(3)).max() > 1e-6 or np.linalg.det(self.R_cam_base) < 0.0:
            raise DataError("R_cam_base of a camera is not a rotation matrix.")

    @property
    def position(self) -> Array:
        """Optical centre in the world, shape (3,) [m]."""
        return np.asarray(-self.R_cam_base.T @ self.t_cam_base)

    def to_camera(self, x_world: ArrayLike) -> Array:
        """Transform world points, shape (..., 3) [m], into the optical frame, shape (..., 3) [m]."""
        return np.asarray(np.asarray(x_world, dtype=float) @ self.R_cam_base.T + self.t_cam_base)

    def project(self, x_world: ArrayLike) -> Array:
        """Project world points into the image.

        Args:
            x_world: Points in the world, shape (..., 3) [m].

        Returns:
            Pixels, shape (..., 2) [px]; NaN for points at or behind the optical centre.
        """
        x_cam = self.to_camera(x_world)
        depth = np.where(x_cam[..., 2:] > 1e-9, x_cam[..., 2:], np.nan)
        return self.to_pixels(distort(x_cam[..., :2] / depth, self.D))

    def project_jacobian(self, x_world: ArrayLike) -> Array:
        """Derivative of :meth:`project` with respect to the world point.

        Args:
            x_world: Points in the world, in front of the camera, shape (..., 3) [m].

        Returns:
            Jacobians, shape (..., 2, 3) [px/m].
        """
        return np.asarray(self._by_camera_point(self.to_camera(x_world)) @ self.R_cam_base)

    def project_by_parameters(self, x_world: ArrayLike) -> Array:
        """Derivative of :meth:`project` with respect to :data:`PARAMETERS`.

        Args:
            x_world: Points in the world, in front of the camera, shape (..., 3) [m].

        Returns:
            Jacobians, shape (..., 2, 15) [px by the unit of each parameter]; a small turn r makes the camera's rotation
            ``exp(r) @ R_cam_base``.
        """
        x_cam = self.to_camera(x_world)
        xn = x_cam[..., :2] / x_cam[..., 2:]
        xd, by_point = distort(xn, self.D), self._by_camera_point(x_cam)
        lens = [distort(xn, self.D + step) - distort(xn, self.D - step) for step in _LENS_STEP * np.eye(len(self.D))]
        # A small turn r moves a point by r x (R X), hence the row vector (R X) x d.
        turn = np.cross((x_cam - self.t_cam_base)[..., None, :], by_point)
        focal = np.zeros((*xd.shape, 2))
        focal[..., 0, 0], focal[..., 1, 1] = xd[..., 0], xd[..., 1]
        centre = np.broadcast_to(np.eye(2), focal.shape)
        by_lens = self.K[:2, :2] @ (np.stack(lens, axis=-1) / (2.0 * _LENS_STEP))
        return np.concatenate((focal, centre, by_lens, turn, by_point), axis=-1)

    def _by_camera_point(self, x_cam: Array) -> Array:
        """Derivative of pixels by points in the optical frame, shape (..., 3) -> (..., 2, 3) [px/m]."""
        inverse_depth = 1.0 / x_cam[..., 2]
        xn = x_cam[..., :2] * inverse_depth[..., None]
        ideal = np.zeros((*x_cam.shape[:-1], 2, 3))
        ideal[..., 0, 0] = inverse_depth
        ideal[..., 1, 1] = inverse_depth
        ideal[..., :, 2] = -xn * inverse_depth[..., None]
        return np.asarray(self.K[:2, :2] @ distort_jacobian(xn, self.D) @ ideal)

    def to_pixels(self, xd: ArrayLike) -> Array:
        """Pixels, shape (..., 2) [px], of distorted points on the plane z = 1, shape (..., 2) [-]."""
        return np.asarray(np.asarray(xd, dtype=float) @ self.K[:2, :2].T + self.K[:2, 2])

    def undistort(self, uv: ArrayLike) -> Array:
        """Ideal points on the plane z = 1 of pixels.

        Args:
            uv: Pixels, shape (..., 2) [px].

        Returns:
            Ideal points, shape (..., 2) [-].

        Raises:
            DataError: The lens model cannot be inverted there.
        """
        pixels = np.asarray(uv, dtype=float) - self.K[:2, 2]
        return undistort(pixels @ np.linalg.inv(self.K[:2, :2]).T, self.D)

    def ray(self, uv: ArrayLike) -> Array:
        """Unit directions in the world through pixels; they start at :attr:`position`.

        Args:
            uv: Pixels, shape (..., 2) [px].

        Returns:
            Unit vectors in the world, shape (..., 3) [-].

        Raises:
            DataError: The lens model cannot be inverted there.
        """
        xn = self.undistort(uv)
        direction = np.concatenate((xn, np.ones((*xn.shape[:-1], 1))), axis=-1) @ self.R_cam_base
        return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))

    def contains(self, uv: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether pixels, shape (..., 2) [px], lie in the image by at least `margin` [px]; False for NaN."""
        pixels = np.asarray(uv, dtype=float)
        low = -0.5 + margin
        high = np.array([self.width, self.height]) - 0.5 - margin
        return np.asarray(np.all((pixels >= low) & (pixels <= high), axis=-1))
