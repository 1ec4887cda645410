"""Input of a calibration: LED positions by the robot, spots in the cameras, and known lengths."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.arm_error import ArmError
from im_calibration.problem.placements import GivenIntrinsics, Placements
from im_cell.lens import PLUMB_BOB, LensModel, lens_of
from im_cell.workspace import Workspace
from im_core.errors import DataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOISE_SOURCES = ("image", "robot")
"""What stated noise is of: the spots, and the positions by the robot."""

_LARGEST = {
    "positions": (1e7, "m"),
    "joint_jacobians": (1e4, "m/rad"),
    "arm_jacobians": (1.0, "m"),
    "spots": (1e6, "px"),
}
"""An origin may be anywhere on the Earth; beyond, and beyond what follows, sums of squares lose or exceed numbers."""
_PRIOR_SDS = 1e-9, 1e3
_POSITION_SDS_M = 0.0, 1e3
_SPOT_SDS_PX = 1e-9, 1e6
_LONGEST_M = 1e3


@dataclass(frozen=True)
class KnownLengths:
    """Two LEDs at measured distances, seen by several cameras: the only judge of the robot's own scale.

    k placements of such pairs, anywhere in view and however turned; a placement is wherever the cameras see it.

    Attributes:
        lengths: Distances of the two LEDs, shape (k,) [m].
        standard_deviations: How well they are known, shape (k,) [m].
        spots: Spots of both LEDs by camera, placement and LED, NaN where not seen, shape (c, k, 2, 2) [px].
        spot_covariances: Their covariances, ignored where there is no spot, shape (c, k, 2, 2, 2) [px^2].
    """

    lengths: Array
    standard_deviations: Array
    spots: Array
    spot_covariances: Array

    def __post_init__(self) -> None:
        """Check shapes and values.

        Raises:
            DataError: An array has the wrong shape or a value that cannot be; the message names it.
        """
        k, c = len(self.lengths), len(self.spots)
        shapes = {"standard_deviations": (k,), "spots": (c, k, 2, 2), "spot_covariances": (c, k, 2, 2, 2)}
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise DataError(f"{name} of the known lengths has shape {value.shape}, it must be {shape}.", array=name)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not np.all((np.asarray(self.lengths) > 0.0) & (np.asarray(self.lengths) <= _LONGEST_M)):
            raise DataError(f"Each known length must be > 0 and at most {_LONGEST_M:g} m.", array="lengths")
        if not np.all((self.standard_deviations >= 0.0) & (self.standard_deviations <= _LONGEST_M)):
            raise DataError(f"Each standard deviation of a known length must be >= 0 and at most {_LONGEST_M:g} m.")
        if np.any(np.isinf(self.spots)) or np.any(np.isnan(self.spots).sum(axis=3) == 1):
            raise DataError("A spot of a known length must be two finite numbers, or two NaN where it was not seen.")
        if np.any(np.abs(self.spots) > _LARGEST["spots"][0]):
            raise DataError(f"A spot of a known length must be within {_LARGEST['spots'][0]:g} px.", array="spots")
        seen = tuple(f"{number} of camera {camera}" for camera, number, _ in np.argwhere(self.detected))
        _check_covariances("spot", "known length", self.spot_covariances[self.detected], seen, _SPOT_SDS_PX)

    @property
    def detected(self) -> Mask:
        """Where a camera saw an LED, shape (c, k, 2)."""
        return np.asarray(~np.isnan(self.spots[..., 0]))


@dataclass(frozen=True)
class CalibrationProblem:
    """Observations of one wrist LED by one or more cameras over n poses of the arm.

    The true LED position of pose i is ``positions[i] + wrist_rotations[i] @ e + joint_jacobians[i] @ dq + noise``; the
    noise has covariance ``position_covariances[i]``, is independent between poses and common to all cameras; `e`
    and `dq` are constant unknowns with zero-mean priors.

    Attributes:
        camera_names: Names of the c cameras.
        image_sizes: Width and height of each camera's image [px].
        positions: LED positions by the robot's kinematics with the nominal LED offset, shape (n, 3) [m].
        position_covariances: Covariances of `positions`, shape (n, 3, 3) [m^2].
        wrist_rotations: Rotations wrist -> base, shape (n, 3, 3).
        spots: Spot centres, NaN where a camera saw none, shape (c, n, 2) [px].
        spot_covariances: Covariances of `spots`, ignored where there is no spot, shape (c, n, 2, 2) [px^2].
        workspace: Where errors are predicted.
        led_offset_prior_sd: Prior standard deviation of each axis of `e` [m]; 0: the nominal offset is exact.
        led_offset_nominal: Nominal LED offset in the wrist frame, for the report only [m].
        joint_offset_prior_sd: Prior standard deviation of each element of `dq` [rad]; 0: no joint offsets.
        joint_jacobians: Derivatives of the positions by the joints, shape (n, 3, k) [m/rad]; None: no joint offsets.
        arm_jacobians: Derivatives of the positions by the errors of the arm's kinematics, each in units of its usual
            size, shape (n, 3, m) [m]; None: the kinematics are not known.
        pose_names: One label a pose; empty: "0", "1", ...
        lengths: Pairs of LEDs at known distances, which judge the robot's scale; None: there are none.
        lens_models: Name of each camera's lens model, see :data:`im_cell.lens.LENSES`; empty: all `plumb_bob`.
        noise_to_estimate: Those of :data:`NOISE_SOURCES` whose covariances are known up to a common factor only.
        arm_error: Smooth error of the arm, beside the noise; None: there is none.
        readings: Label of each pose's reading of the robot: the positions of one reading are off together; empty: each
            pose has its own.
        placements: Targets among the positions whose places are unknown; None: there are none.
        given_intrinsics: What is known of each camera's intrinsics beforehand; empty: nothing.

    >>> problem.lens_models, problem.pose_names[:3], problem.fewest_spots.tolist(), int(problem.detected.sum())
    (('plumb_bob',), ('0', '1', '2'), [7], 40)
    """

    camera_names: tuple[str, ...]
    image_sizes: tuple[tuple[int, int], ...]
    positions: Array
    position_covariances: Array
    wrist_rotations: Array
    spots: Array
    spot_covariances: Array
    workspace: Workspace
    led_offset_prior_sd: float = 0.0
    led_offset_nominal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint_offset_prior_sd: float = 0.0
    joint_jacobians: Array | None = None
    arm_jacobians: Array | None = None
    pose_names: tuple[str, ...] = ()
    lengths: KnownLengths | None = None
    lens_models: tuple[str, ...] = ()
    noise_to_estimate: tuple[str, ...] = ()
    arm_error: ArmError | None = None
    readings: tuple[str, ...] = ()
    placements: Placements | None = None
    given_intrinsics: tuple[GivenIntrinsics | None, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes and values.

        Raises:
            DataError: An array has the wrong shape or a value that cannot be; the message names it.
        """
        c, n = len(self.camera_names), len(self.positions)
        if c == 0:
            raise DataError("A calibration needs at least one camera, none is given.")
        if n == 0:
            raise DataError("A calibration needs poses, none is given.")
        if len(set(self.camera_names)) != c:
            raise DataError(f"Each camera may be given once, got {', '.join(self.camera_names)}.")
        if len(self.image_sizes) != c or any(side < 1 for size in self.image_sizes for side in size):
            raise DataError(f"Image sizes are {self.image_sizes}, {c} pairs of positive numbers are needed.")
        if not set(self.noise_to_estimate) <= set(NOISE_SOURCES):
            raise DataError(f"noise_to_estimate is {self.noise_to_estimate}, it may hold {', '.join(NOISE_SOURCES)}.")
        shapes = {
            "positions": (n, 3),
            "position_covariances": (n, 3, 3),
            "wrist_rotations": (n, 3, 3),
            "spots": (c, n, 2),
            "spot_covariances": (c, n, 2, 2),
        }
        for name in ("joint_jacobians", "arm_jacobians"):
            if (given := getattr(self, name)) is not None:
                shapes[name] = (n, 3, np.shape(given)[-1])
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise DataError(f"{name} has shape {value.shape}, it must be {shape}.", array=name)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.lengths is not None and len(self.lengths.spots) != c:
            raise DataError(f"The known lengths have spots of {len(self.lengths.spots)} cameras, there are {c}.")
        if not self.pose_names:
            object.__setattr__(self, "pose_names", tuple(str(i) for i in range(n)))
        if len(self.pose_names) != n:
            raise DataError(f"There are {len(self.pose_names)} pose names for {n} poses.")
        if self.readings and len(self.readings) != n:
            raise DataError(f"There are {len(self.readings)} readings for {n} poses.")
        if not self.lens_models:
            object.__setattr__(self, "lens_models", (PLUMB_BOB.name,) * c)
        if len(self.lens_models) != c:
            raise DataError(f"There are {len(self.lens_models)} lens models for {c} cameras.")
        for name in self.lens_models:
            lens_of(name)
        self._check_values()

    def _check_values(self) -> None:
        for name in ("positions", "position_covariances", "wrist_rotations", "joint_jacobians", "arm_jacobians"):
            value = getattr(self, name)
            if value is not None and not np.all(np.isfinite(value)):
                pose = self.pose_names[int(np.argwhere(~np.isfinite(value))[0, 0])]
                raise DataError(f"{name} of pose {pose} holds a value that is not finite.", array=name, pose=pose)
        if np.any(np.isinf(self.spots)) or np.any(np.isnan(self.spots).sum(axis=2) == 1):
            raise DataError("A spot must be two finite numbers, or two NaN where the LED was not seen.")
        for name, (largest, unit) in _LARGEST.items():
            value = getattr(self, name)
            if value is not None and np.any(np.abs(value) > largest):
                found = np.nanmax(np.abs(value))
                raise DataError(f"A value of {name} is {found:g} {unit}, it must be at most {largest:g}.", array=name)
        for name in ("led_offset_prior_sd", "joint_offset_prior_sd"):
            value, (low, high) = getattr(self, name), _PRIOR_SDS
            if not (value == 0.0 or low <= value <= high):
                raise DataError(f"{name} is {value:g}, it must be 0, which is exact, or within {low:g} and {high:g}.")
        if self.joint_offset_prior_sd > 0.0 and self.joint_jacobians is None:
            raise DataError("joint_offset_prior_sd > 0 needs joint_jacobians, none are given.")
        rotations = self.wrist_rotations
        defect = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        for i in np.flatnonzero((defect > 1e-4) | (np.linalg.det(rotations) < 0.0)):
            raise DataError(f"The wrist rotation of pose {self.pose_names[i]} is not a rotation matrix.")
        _check_covariances("position", "pose", self.position_covariances, self.pose_names, _POSITION_SDS_M)
        for c, camera in enumerate(self.camera_names):
            seen = self.detected[c]
            names = tuple(np.array(self.pose_names, dtype=object)[seen])
            _check_covariances(f"{camera} spot", "pose", self.spot_covariances[c][seen], names, _SPOT_SDS_PX)

    @property
    def lenses(self) -> tuple[LensModel, ...]:
        """Lens models of the cameras."""
        return tuple(lens_of(name) for name in self.lens_models)

    @property
    def fewest_spots(self) -> NDArray[np.intp]:
        """Fewest spots of each camera: as many image coordinates as unknowns, shape (c,)."""
        return np.array([(10 + lens.estimated + 1) // 2 for lens in self.lenses])

    @property
    def detected(self) -> Mask:
        """Where a camera saw the LED, shape (c, n)."""
        return np.asarray(~np.isnan(self.spots[..., 0]))

    @cached_property
    def poses_of_readings(self) -> NDArray[np.intp]:
        """Poses of each of r readings, -1 behind them, shape (r, most)."""
        n = len(self.positions)
        if not self.readings:
            return np.arange(n)[:, None]
        numbers = np.unique(np.array(self.readings), return_inverse=True)[1]
        order, counts = np.argsort(numbers, kind="stable"), np.bincount(numbers)
        table = np.full((len(counts), counts.max()), -1)
        table[np.arange(counts.max()) < counts[:, None]] = order
        return table

    def by_reading(self, each: Array) -> Array:
        """Put rows of the poses of each reading in a row, zeros last, shape (n, w, ...) -> (r, most w, ...)."""
        table = self.poses_of_readings
        there = (table >= 0).reshape(*table.shape, *[1] * (each.ndim - 1))
        return np.asarray(each[table] * there).reshape(len(table), -1, *each.shape[2:])

    def joined(self, blocks: Array, rest: float) -> Array:
        """Put matrices of the poses of each reading on one diagonal, shape (n, w, w) -> (r, most w, most w).

        Args:
            blocks: The matrices.
            rest: Elements of the diagonal behind them.
        """
        table, width = self.poses_of_readings, blocks.shape[1]
        joined = np.tile(rest * np.eye(table.shape[1] * width), (len(table), 1, 1))
        for number, poses in enumerate(table.T):
            rows = slice(number * width, (number + 1) * width)
            joined[poses >= 0, rows, rows] = blocks[poses[poses >= 0]]
        return joined

    @cached_property
    def shared_roots(self) -> Array:
        """Roots of the covariances of positions with a reading of several poses, 0 of the others, shape (n, 3, 3) [m].

        Of the points of a target on a robot, whose place and turn are both read, shape (n, 3, 6).
        The positions of a reading are off by their root times one vector of unit covariance: by the same, where the
        covariances are the same.
        """
        if self.placements is not None and self.placements.roots is not None:
            return self.placements.roots
        roots = np.zeros_like(self.position_covariances)
        table = self.poses_of_readings
        poses = table[(table >= 0).sum(axis=1) > 1]
        poses = poses[poses >= 0]
        values, axes = np.linalg.eigh(self.position_covariances[poses])
        roots[poses] = (axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(axes, 1, 2)
        return roots

    @property
    def reading_error(self) -> ArmError | None:
        """Largest smooth error of a robot's readings with a target, without its kinematics; None of all others."""
        return None if self.placements is None else self.placements.arm

    @cached_property
    def largest_arm_error(self) -> ArmError:
        """Largest smooth error that the arm may have."""
        return self.reading_error or ArmError.largest(self.positions, self.wrist_rotations, self.arm_jacobians)

    @cached_property
    def shared_errors(self) -> Array:
        """Derivatives of the positions by the errors of k readings of several poses, shape (n, 3, 3k), or 6k [m]."""
        several = [poses[poses >= 0] for poses in self.poses_of_readings if (poses >= 0).sum() > 1]
        size = self.shared_roots.shape[2]
        shared = np.zeros((len(self.positions), 3, size * len(several)))
        for number, poses in enumerate(several):
            shared[poses, :, size * number : size * (number + 1)] = self.shared_roots[poses]
        return shared

    @cached_property
    def own_covariances(self) -> Array:
        """Covariances of what each position is off by itself, 0 in a reading of several, shape (n, 3, 3) [m^2]."""
        table, own = self.poses_of_readings, np.ones(len(self.positions))
        own[table[((table >= 0).sum(axis=1) > 1)[:, None] & (table >= 0)]] = 0.0
        return self.position_covariances * own[:, None, None]

    @cached_property
    def position_weights(self) -> Array:
        """Inverses of :attr:`own_covariances`, 0 along exactly known directions, shape (n, 3, 3) [1/m^2]."""
        return np.asarray(np.linalg.pinv(self.own_covariances, hermitian=True))

    def with_noise(self, image: float, robot: float) -> "CalibrationProblem":
        """Return the problem with other stated noise; the noise of the spots of known lengths is unchanged.

        Args:
            image: Factor on the standard deviations of the spots.
            robot: Factor on those of the positions.
        """
        return replace(
            self,
            spot_covariances=image**2 * self.spot_covariances,
            position_covariances=robot**2 * self.position_covariances,
            placements=self.placements and self.placements.with_noise(robot),
        )

    def moved(self, by: Array) -> "CalibrationProblem":
        """Return the problem in a world with another origin: all places have ``by`` added, shape (3,) [m]."""
        placements = self.placements and self.placements.moved(by)
        moved = self.positions + by
        return replace(self, positions=moved, workspace=self.workspace.moved(by), placements=placements)

    def taking(self, poses: NDArray[np.intp]) -> "CalibrationProblem":
        """The problem of some poses, in the order given."""
        return replace(
            self,
            positions=self.positions[poses],
            position_covariances=self.position_covariances[poses],
            wrist_rotations=self.wrist_rotations[poses],
            spots=self.spots[:, poses],
            spot_covariances=self.spot_covariances[:, poses],
            joint_jacobians=None if self.joint_jacobians is None else self.joint_jacobians[poses],
            arm_jacobians=None if self.arm_jacobians is None else self.arm_jacobians[poses],
            pose_names=tuple(self.pose_names[i] for i in poses),
            arm_error=None if self.arm_error is None else self.arm_error.taking(poses),
            readings=tuple(self.readings[i] for i in poses) if self.readings else (),
            placements=self.placements and self.placements.taking(poses),
        )

    def of_cameras(self, names: Sequence[str]) -> "CalibrationProblem":
        """Return the problem of some cameras, in the order given."""
        chosen = [self.camera_names.index(name) for name in names]
        lengths = self.lengths and replace(
            self.lengths,
            spots=self.lengths.spots[chosen],
            spot_covariances=self.lengths.spot_covariances[chosen],
        )
        return replace(
            self,
            camera_names=tuple(names),
            image_sizes=tuple(self.image_sizes[c] for c in chosen),
            spots=self.spots[chosen],
            spot_covariances=self.spot_covariances[chosen],
            lengths=lengths,
            lens_models=tuple(self.lens_models[c] for c in chosen),
            given_intrinsics=tuple(self.given_intrinsics[c] for c in chosen) if self.given_intrinsics else (),
        )


def _check_covariances(
    what: str, at: str, covariances: Array, names: tuple[str, ...], sds: tuple[float, float]
) -> None:
    """Refuse a matrix if not a covariance, or with deviations outside two limits; from 0, a singular one passes."""
    low, high = sds
    finite = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    known = np.where(finite[:, None, None], covariances, 0.0)
    scale, lowest = np.abs(known).max(axis=(1, 2)), np.linalg.eigvalsh(known)[:, 0]
    symmetric = np.abs(known - np.swapaxes(known, 1, 2)).max(axis=(1, 2)) <= 1e-6 * scale
    proper = finite & symmetric & (lowest > 0.0 if low > 0.0 else lowest >= -1e-9 * scale)
    variances = np.column_stack((lowest if low > 0.0 else scale, scale))
    outside = (variances < low**2) | (variances > high**2)
    for i in np.flatnonzero(~proper | outside.any(axis=1)):
        text, found = f"The {what} covariance of {at} {names[i]}", {at: names[i]}
        if not proper[i]:
            raise DataError(f"{text} is not a covariance matrix.", **found)
        deviation = variances[i, np.argmax(outside[i])] ** 0.5
        limits = f"it must be within {low:g} and {high:g}."
        raise DataError(f"{text} has a standard deviation of {deviation:g}, {limits}", **found)
