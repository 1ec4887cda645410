"""Unknowns of a calibration and the places of the unknowns in the parameter vector."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.problem import CalibrationProblem
from im_cell.camera_model import CameraModel
from im_cell.lens import PLUMB_BOB, RATIONAL_POLYNOMIAL, LensModel

Array = NDArray[np.float64]

_PINHOLE = ("fx", "fy", "cx", "cy")
_POSE = ("rx", "ry", "rz", "tx", "ty", "tz")

CENTRE_PRIOR_SD = 0.075
"""How far the principal point of any machine-vision lens is from the middle of its image [image widths], if the image
ends :data:`LENS_RADIUS` from the axis. That of a longer lens is off by an angle."""

LENS_PRIOR_SD = {1: 0.015, 2: 0.7, 4: 1.5, 6: 4.0, 8: 10.0}
"""Coefficients that any machine-vision lens keeps to whose image ends :data:`LENS_RADIUS` from the axis [-], by the
power of their effect. Far wider than what data of a good design say, so that it matters only where they say little:
there the likelihood is so flat and bent that its maximum runs away to lenses nobody can buy."""

LENS_RADIUS = 0.6
"""Distance from the axis [-], of a tangent, at which a term's effect on the image is judged, or at the corner of the
image if that is nearer. Farther out the terms of a wide lens are large and cancel each other."""


HELD_SD = 1e-9
"""Standard deviation of the pose of a camera that is the world's frame [rad], [m]."""


def camera_parameters(lens: LensModel) -> tuple[str, ...]:
    """Order of a camera's parameters: [px] x 4, lens [-], rotation vector in the camera frame [rad] x 3, [m] x 3."""
    return (*_PINHOLE, *lens.coefficients[: lens.estimated], *_POSE)


def intrinsics_of(cameras: Sequence[CameraModel]) -> Array:
    """Return the intrinsics of c cameras, in the form of :class:`Unknowns`."""
    widest = max(camera.lens.estimated for camera in cameras)
    intrinsics = np.zeros((len(cameras), 4 + widest))
    for row, camera in zip(intrinsics, cameras, strict=True):
        row[:4] = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
        row[4 : 4 + camera.lens.estimated] = camera.D[: camera.lens.estimated]
    return intrinsics


def lens_reach(focal_px: float, image_size: tuple[int, int], lens: LensModel = PLUMB_BOB) -> float:
    """How far from the axis the effect of lens terms is judged, as a share of :data:`LENS_RADIUS`.

    A term k of power m moves a point there by ``k * (reach * LENS_RADIUS)^m`` of its distance from the middle of the
    image: what is said of terms is said of this effect in the image, whatever the focal length.

    Args:
        focal_px: Focal length [px].
        image_size: Width and height [px].
        lens: The lens model; the quotient of `rational_polynomial` has no need of large terms, and with them poles.
    """
    corner = float(np.hypot(*image_size)) / 2.0 / focal_px
    return corner / LENS_RADIUS if lens is RATIONAL_POLYNOMIAL else min(1.0, corner / LENS_RADIUS)


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of the unknowns, at one value of the unknowns.

    Attributes:
        chi2: Squared deviation from the prior means, in standard deviations.
        gradient: Half its negative derivative by the unknowns, shape (size,).
        information: Its Gauss-Newton normal matrix, shape (size, size).
        lens_chi2: The part of `chi2` that concerns cameras, and no data set states.
        lens_information: The same part of `information`, shape (size, size).
    """

    chi2: float
    gradient: Array
    information: Array
    lens_chi2: float
    lens_information: Array


@dataclass(frozen=True)
class ParameterLayout:
    """Which unknowns a problem has, and where: cameras, LED and joint offsets, readings, placements, error of the arm.

    Attributes:
        lenses: Lens models of the cameras.
        led: Whether the LED offset is estimated.
        joints: Number of joint offsets that are estimated.
        shared: Number of errors of readings that several poses share, three a reading.
        placed: Number of unknowns of the placements of targets, six each.
        arm: Number of coefficients of the arm's error.
        image_sizes: Width and height of each image [px].
        prior_mean: Prior means, 0 where there is no prior, shape (size,).
        prior_precision: Inverse prior variances, 0 where there is no prior, shape (size,); of lens terms, those of an
            image that ends at :data:`LENS_RADIUS`.
        given: Means and precision matrix of the cameras' unknowns as given, shapes (cameras_size,) and its square;
            None: nothing is given.
        free_size: Number of unknowns on which nothing but the spots, or the usual lenses, say anything.
    """

    lenses: tuple[LensModel, ...]
    led: bool
    joints: int
    shared: int
    placed: int
    arm: int
    image_sizes: tuple[tuple[int, int], ...]
    prior_mean: Array
    prior_precision: Array
    given: tuple[Array, Array] | None
    free_size: int

    @staticmethod
    def of(problem: CalibrationProblem) -> "ParameterLayout":
        """Return the ParameterLayout of the unknowns of a problem."""
        led = problem.led_offset_prior_sd > 0.0
        joints = 0
        if problem.joint_jacobians is not None and problem.joint_offset_prior_sd > 0.0:
            joints = problem.joint_jacobians.shape[2]
        arm = 0 if problem.arm_error is None else problem.arm_error.jacobians.shape[2]
        means, precisions = [], []
        for (width, height), lens in zip(problem.image_sizes, problem.lenses, strict=True):
            middle = ((width - 1.0) / 2.0, (height - 1.0) / 2.0)
            means += [0.0, 0.0, *middle, *[0.0] * (lens.estimated + len(_POSE))]
            precisions += [0.0, 0.0, *[(CENTRE_PRIOR_SD * width) ** -2] * 2]
            precisions += [LENS_PRIOR_SD[power] ** -2 for power in lens.powers[: lens.estimated]] + [0.0] * len(_POSE)
        shared = problem.shared_errors.shape[2]
        cameras_size, placed = len(means), 0 if problem.placements is None else 6 * problem.placements.count
        means += [0.0] * (3 * led + joints + shared + placed + arm)
        precisions += [problem.led_offset_prior_sd**-2] * 3 if led else []
        precisions += [problem.joint_offset_prior_sd**-2] * joints if joints else []
        precisions += [1.0] * shared + [0.0] * placed + [1.0] * arm
        given, known = _given(problem, cameras_size)
        return ParameterLayout(
            problem.lenses,
            led,
            joints,
            shared,
            placed,
            arm,
            problem.image_sizes,
            np.array(means),
            np.array(precisions),
            given,
            cameras_size + placed - known,
        )

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return len(self.lenses)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.prior_precision)

    @cached_property
    def cameras_size(self) -> int:
        """Number of unknowns of all cameras, which are the first."""
        return self.size - 3 * self.led - self.joints - self.shared - self.placed - self.arm

    @cached_property
    def stated_precision(self) -> Array:
        """Inverse prior variances stated by the data set: of LED and joint offsets, 0 elsewhere, shape (size,)."""
        return np.asarray(np.where(np.arange(self.size) < self.cameras_size, 0.0, self.prior_precision))

    def prior(self, unknowns: "Unknowns") -> Prior:
        """Return the prior at a value of the unknowns; the prior of lens terms is on the effect, thus also on fx."""
        deviation, precision = unknowns.prior_vector(self), self.prior_precision.copy()
        cameras = slice(0, self.cameras_size)
        slopes = np.zeros((self.cameras_size,) * 2)  # of the whitened deviation by fx, less that by the term itself
        for c, term, power, reach in self._reaching(unknowns):
            precision[term] *= reach ** (2 * power)
            slopes[term, self.camera_slice(c).start] = -power * deviation[term] / float(unknowns.intrinsics[c, 0])
        jacobian = slopes * np.sqrt(precision)[cameras, None]
        cross = slopes * precision[cameras, None]
        information, gradient = np.diag(precision), -precision * deviation
        information[cameras, cameras] += cross + cross.T + jacobian.T @ jacobian
        gradient[cameras] -= cross.T @ deviation[cameras]
        chi2, stated = _chi2(deviation, precision), self.stated_precision
        lens_chi2 = chi2 - float(deviation @ (stated * deviation))
        lens_information = information - np.diag(stated)
        if self.given is not None:
            off = self._from_given(unknowns)
            information[cameras, cameras] += self.given[1]
            gradient[cameras] -= self.given[1] @ off
            chi2 += float(off @ self.given[1] @ off)
        return Prior(chi2, gradient, information, lens_chi2, lens_information)

    def prior_chi2(self, unknowns: "Unknowns") -> float:
        """The first part of :meth:`prior`, without the others."""
        precision = self.prior_precision.copy()
        for _, term, power, reach in self._reaching(unknowns):
            precision[term] *= reach ** (2 * power)
        chi2 = _chi2(unknowns.prior_vector(self), precision)
        if self.given is not None:
            off = self._from_given(unknowns)
            chi2 += float(off @ self.given[1] @ off)
        return chi2

    def _from_given(self, unknowns: "Unknowns") -> Array:
        """Return intrinsics less those that are given; poses that are given are never left, shape (cameras_size,)."""
        assert self.given is not None
        off = np.zeros(self.cameras_size)
        for c in range(self.cameras):
            block = self.camera_slice(c)
            size = block.stop - block.start - len(_POSE)
            off[block.start : block.start + size] = unknowns.intrinsics[c, :size]
        return np.where(np.diag(self.given[1]) > 0.0, off - self.given[0], 0.0)

    def _reaching(self, unknowns: "Unknowns") -> Iterator[tuple[int, int, int, float]]:
        """Yield camera, place and power of terms with effect not judged at :data:`LENS_RADIUS`, and the reach there."""
        for c, (size, lens) in enumerate(zip(self.image_sizes, self.lenses, strict=True)):
            first, reach = self.camera_slice(c).start, lens_reach(float(unknowns.intrinsics[c, 0]), size, lens)
            if reach != 1.0:
                for term, power in enumerate((1, 1, *lens.powers[: lens.estimated]), start=first + 2):
                    if term >= first + 4 or reach < 1.0:
                        yield c, term, power, reach

    @property
    def led_slice(self) -> slice:
        """Place of the LED offset; empty if the offset is known."""
        start = self.cameras_size
        return slice(start, start + 3 * self.led)

    @property
    def joint_slice(self) -> slice:
        """Place of the joint offsets; empty if there are none."""
        start = self.shared_slice.start
        return slice(start - self.joints, start)

    @property
    def shared_slice(self) -> slice:
        """Place of the errors of shared readings; empty without."""
        return slice(self.placed_slice.start - self.shared, self.placed_slice.start)

    @property
    def placed_slice(self) -> slice:
        """Place of the placements of targets, a turn [rad] and a shift [m] each; empty without."""
        return slice(self.arm_slice.start - self.placed, self.arm_slice.start)

    @property
    def arm_slice(self) -> slice:
        """Place of the coefficients of the arm's error; empty without."""
        return slice(self.size - self.arm, self.size)

    def camera_slice(self, c: int) -> slice:
        """Place of the parameters of camera `c`."""
        return self._camera_slices[c]

    @cached_property
    def _camera_slices(self) -> tuple[slice, ...]:
        ends = list(accumulate((_count(lens) for lens in self.lenses), initial=0))
        return tuple(slice(start, end) for start, end in pairwise(ends))

    def names(self, camera_names: tuple[str, ...]) -> tuple[str, ...]:
        """Name of each unknown of cameras and offsets: ``ceiling_left.fx``, ``led_offset.x``, ``joint_offset.0``."""
        cameras = [
            f"{camera}.{name}"
            for camera, lens in zip(camera_names, self.lenses, strict=True)
            for name in camera_parameters(lens)
        ]
        led = [f"led_offset.{axis}" for axis in "xyz"] if self.led else []
        return (*cameras, *led, *(f"joint_offset.{j}" for j in range(self.joints)))


@dataclass(frozen=True)
class Unknowns:
    """A value of all unknowns.

    Attributes:
        lenses: Lens models of the cameras.
        intrinsics: fx, fy, cx, cy [px] and the coefficients of the lens that are estimated [-] of each camera, zeros
            behind them, shape (c, 4 + most).
        rotations: Rotations base -> camera, shape (c, 3, 3).
        translations: Origin of the base in each camera frame, shape (c, 3) [m].
        led_offset: Error of the nominal LED offset, in the wrist frame, shape (3,) [m].
        joint_offsets: Constant errors of the joint readings, shape (k,) [rad].
        displacements: LED positions minus where the robot's readings, offsets corrected, put them, shape (n, 3) [m].
        arm_error: Coefficients of the arm's error, shape (m,) [-].
        shared_errors: Errors of shared readings, in standard deviations, shape (3r,) or (6r,) [-].
        placements: Rotations and translations of targets from where the positions have them, shape (m, 3, 4) [-], [m].
    """

    lenses: tuple[LensModel, ...]
    intrinsics: Array
    rotations: Array
    translations: Array
    led_offset: Array
    joint_offsets: Array
    displacements: Array
    arm_error: Array = field(default_factory=lambda: np.zeros(0))
    shared_errors: Array = field(default_factory=lambda: np.zeros(0))
    placements: Array = field(default_factory=lambda: np.zeros((0, 3, 4)))

    def coefficients(self, c: int) -> Array:
        """Return the lens coefficients of camera `c`."""
        lens = self.lenses[c]
        return lens.all_of(self.intrinsics[c, 4 : 4 + lens.estimated])

    def robot_positions(self, problem: CalibrationProblem) -> Array:
        """Return the LED positions by the robot, corrected for offsets and arm, shape (n, 3) [m]."""
        positions = problem.positions + problem.wrist_rotations @ self.led_offset
        if problem.joint_jacobians is not None and len(self.joint_offsets):
            positions = positions + problem.joint_jacobians @ self.joint_offsets
        if problem.arm_error is not None:
            positions = positions + problem.arm_error.jacobians @ self.arm_error
        if len(self.shared_errors):
            positions = positions + problem.shared_errors @ self.shared_errors
        if problem.placements is not None:
            positions = positions + problem.placements.displacements(self.placements)
        return np.asarray(positions)

    def led_positions(self, problem: CalibrationProblem) -> Array:
        """Return estimated LED positions: the robot's positions, moved to agree with the spots, shape (n, 3) [m]."""
        return self.robot_positions(problem) + self.displacements

    def moved(self, step: Array, layout: ParameterLayout, displacements: Array) -> "Unknowns":
        """Return the unknowns after a step; a rotation moves by ``exp(step) @ R``.

        Args:
            step: Change of the parameter vector, shape (size,).
            layout: Places of the unknowns in it.
            displacements: New displacements, shape (n, 3) [m].
        """
        parts = [step[layout.camera_slice(c)] for c in range(layout.cameras)]
        intrinsics = self.intrinsics.copy()
        for row, part in zip(intrinsics, parts, strict=True):
            row[: len(part) - 6] += part[:-6]
        return Unknowns(
            self.lenses,
            intrinsics,
            rotation_exp(np.array([part[-6:-3] for part in parts])) @ self.rotations,
            self.translations + np.array([part[-3:] for part in parts]),
            self.led_offset + (step[layout.led_slice] if layout.led else 0.0),
            self.joint_offsets + step[layout.joint_slice],
            displacements,
            self.arm_error + step[layout.arm_slice],
            self.shared_errors + step[layout.shared_slice],
            _placed_anew(self.placements, step[layout.placed_slice].reshape(-1, 6)),
        )

    def prior_vector(self, layout: ParameterLayout) -> Array:
        """Return the deviation of each unknown from the prior mean, 0 without a prior, shape (size,)."""
        vector = np.zeros(layout.size)
        for c in range(layout.cameras):
            block = vector[layout.camera_slice(c)]
            block[:-6] = self.intrinsics[c, : len(block) - 6]
        if layout.led:
            vector[layout.led_slice] = self.led_offset
        vector[layout.joint_slice] = self.joint_offsets
        vector[layout.shared_slice] = self.shared_errors
        vector[layout.arm_slice] = self.arm_error
        return np.where(layout.prior_precision > 0.0, vector - layout.prior_mean, 0.0)


def _chi2(deviation: Array, precision: Array) -> float:
    return float(deviation @ (precision * deviation))


def _placed_anew(placements: Array, steps: Array) -> Array:
    """Return placements after steps, turn [rad] and shift [m], shape (m, 6)."""
    moved = placements.copy()
    moved[:, :, :3] = rotation_exp(steps[:, :3]) @ placements[:, :, :3]
    moved[:, :, 3] += steps[:, 3:]
    return moved


def _given(problem: CalibrationProblem, size: int) -> tuple[tuple[Array, Array] | None, int]:
    """Return means and precisions of the given unknowns of cameras, and the number of unknowns."""
    means, precision, known, start = np.zeros(size), np.zeros((size, size)), 0, 0
    for c, lens in enumerate(problem.lenses):
        count = len(_PINHOLE) + lens.estimated
        if problem.given_intrinsics and (given := problem.given_intrinsics[c]) is not None:
            block = slice(start, start + count)
            means[block], precision[block, block] = given.values, given.precision
            known += count
        if c == 0 and problem.placements is not None and problem.placements.held is not None:
            pose = np.arange(start + count, start + count + len(_POSE))
            precision[pose, pose] = HELD_SD**-2
            known += len(_POSE)
        start += count + len(_POSE)
    return ((means, precision) if known else None), known


def _count(lens: LensModel) -> int:
    """Number of unknowns of a camera."""
    return len(_PINHOLE) + lens.estimated + len(_POSE)


def skew(v: Array) -> Array:
    """Cross-product matrices of vectors, shape (..., 3) -> (..., 3, 3)."""
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def rotation_exp(vectors: Array) -> Array:
    """Rotation matrices of rotation vectors (Rodrigues), shape (c, 3) [rad] -> (c, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    k = skew(vectors)
    half = np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * half**2 * (k @ k))
