"""Camera with a lens and a pose in the world.

Conventions (OpenCV and REP-105): ``x_cam = R_cam_base @ x_world + t_cam_base``; z forward, x right, y down; the centre
of the upper left pixel is (0, 0); lens models and their D are those of :mod:`im_cell.lens`.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_cell.lens import COEFFICIENTS, PLUMB_BOB, LensModel, lens_of
from im_cell.robot.parameters import Camera
from im_core.errors import DataError

Array = NDArray[np.float64]

_PINHOLE = ("fx", "fy", "cx", "cy")
_POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
PARAMETERS = (*_PINHOLE, *COEFFICIENTS, *_POSE)
"""What describes a camera: pinhole [px], lens, of whichever model [-], turn in the camera frame [rad], shift [m]."""
POSE_PARAMETERS = len(_POSE)
"""How many of them, the last ones, are the pose."""
_SHARES = np.linspace(1.0, 0.05, 20)


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics, lens and pose of one camera.

    Attributes:
        width: Image width [px].
        height: Image height [px].
        K: Camera matrix, shape (3, 3) [px].
        D: Coefficients of the lens model, shape (5,) for `plumb_bob` [-].
        R_cam_base: Rotation world -> camera, shape (3, 3) [-].
        t_cam_base: Origin of the world in the camera frame, shape (3,) [m].
        distortion_model: Name of the lens model.

    >>> camera.position.tolist(), camera.ray([319.5, 239.5]).tolist()
    ([0.0, 0.0, 3.0], [0.0, 0.0, -1.0])
    >>> camera.contains(camera.project([[0.1, 0.0, 1.0], [5.0, 0.0, 1.0]])).tolist()
    [True, False]
    >>> CameraModel(640, 480, K, D=np.zeros(4))
    Traceback (most recent call last):
    im_core.errors.DataError: D of a camera has shape (4,), it must be (5,).
    """

    width: int
    height: int
    K: Array
    D: Array
    R_cam_base: Array = field(default_factory=lambda: np.eye(3))
    t_cam_base: Array = field(default_factory=lambda: np.zeros(3))
    distortion_model: str = PLUMB_BOB.name

    def __post_init__(self) -> None:
        """Check shapes and values.

        Raises:
            DataError: A matrix has the wrong shape, is not finite, or is not a camera matrix or a rotation; there is no
                such lens model.
        """
        shapes = {"K": (3, 3), "D": (len(self.lens.coefficients),), "R_cam_base": (3, 3), "t_cam_base": (3,)}
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
    def lens(self) -> LensModel:
        """The lens model."""
        return lens_of(self.distortion_model)

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
        return self.through_lens(x_cam[..., :2] / depth)

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
            Jacobians, shape (..., 2, 18) [px by the unit of each parameter]; a small turn r makes the camera's rotation
            ``exp(r) @ R_cam_base``; coefficients that the lens model has not are without effect.
        """
        x_cam = self.to_camera(x_world)
        xn = x_cam[..., :2] / x_cam[..., 2:]
        xd, by_point = self.lens.distort(xn, self.D), self._by_camera_point(x_cam)
        # A small turn r moves a point by r x (R X), hence the row vector (R X) x d.
        turn = np.cross((x_cam - self.t_cam_base)[..., None, :], by_point)
        focal = np.zeros((*xd.shape, 2))
        focal[..., 0, 0], focal[..., 1, 1] = xd[..., 0], xd[..., 1]
        centre = np.broadcast_to(np.eye(2), focal.shape)
        by_lens = np.zeros((*xd.shape, len(COEFFICIENTS)))
        columns = [COEFFICIENTS.index(name) for name in self.lens.coefficients]
        by_lens[..., columns] = self.K[:2, :2] @ self.lens.by_coefficients(xn, self.D, (1.0, 1.0))
        return np.concatenate((focal, centre, by_lens, turn, by_point), axis=-1)

    def _by_camera_point(self, x_cam: Array) -> Array:
        """Derivative of pixels by points in the optical frame, shape (..., 3) -> (..., 2, 3) [px/m]."""
        inverse_depth = 1.0 / x_cam[..., 2]
        xn = x_cam[..., :2] * inverse_depth[..., None]
        ideal = np.zeros((*x_cam.shape[:-1], 2, 3))
        ideal[..., 0, 0] = inverse_depth
        ideal[..., 1, 1] = inverse_depth
        ideal[..., :, 2] = -xn * inverse_depth[..., None]
        return np.asarray(self.K[:2, :2] @ self.lens.jacobian(xn, self.D) @ ideal)

    def through_lens(self, xn: ArrayLike) -> Array:
        """Pixels, shape (..., 2) [px], of ideal points on the plane z = 1, shape (..., 2) [-]."""
        return self.to_pixels(self.lens.distort(xn, self.D))

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
        return self.lens.undistort(self._on_plane(uv), self.D)

    def undistort_or_nan(self, uv: ArrayLike) -> Array:
        """As :meth:`undistort`, with NaN where the lens model cannot be inverted."""
        points, solved = self.lens.inverse(self._on_plane(uv), self.D)
        return np.where(solved[..., None], points, np.nan)

    def _on_plane(self, uv: ArrayLike) -> Array:
        """Return the distorted points on the plane z = 1 of pixels, shape (..., 2) [-]."""
        return np.asarray((np.asarray(uv, dtype=float) - self.K[:2, 2]) @ np.linalg.inv(self.K[:2, :2]).T)

    def corners(self, share: float = 1.0) -> Array:
        """Return the corners of the image, or of its middle part of a share of its sides, clockwise, (4, 2) [px]."""
        sides = np.array([self.width, self.height])
        return np.asarray((sides - 1.0) / 2.0 + 0.5 * share * sides * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))

    @cached_property
    def invertible_share(self) -> float:
        """Share of the image's sides within which the lens can be inverted, in steps of 0.05; 0: nowhere."""
        for share in _SHARES.tolist():
            try:
                self.undistort(self.corners(share))
            except DataError:
                continue
            return float(share)
        return 0.0

    def ray(self, uv: ArrayLike) -> Array:
        """Return unit directions in the world through pixels; the rays start at :attr:`position`.

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


def nominal(camera: Camera) -> CameraModel:
    """Return a camera as in the cell's drawing, without distortion."""
    lens = camera.intrinsics
    rotation, translation = camera.pose()
    return CameraModel(
        width=lens.width,
        height=lens.height,
        K=np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]),
        D=np.zeros(5),
        R_cam_base=rotation,
        t_cam_base=translation,
    )
