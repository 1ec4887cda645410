"""Result of a calibration: the cameras, the accuracy, and whether to trust the cameras."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_beyond
from im_calibration.judgement.checks import Checks
from im_calibration.judgement.expected import ImageError
from im_calibration.judgement.neighbours import Neighbours
from im_calibration.judgement.noise import Noise
from im_calibration.judgement.scale import Scale
from im_cell.calibration_error import CalibrationError
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import CameraModel
from im_cell.rotations import cross_matrix

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


_ARM = (
    "The error of the arm is taken to be about {:.2g} mm in each coordinate, alike at neighbours; all stated errors "
    "include it."
)
_CURVED = 1.0
_CURVE = (
    "The parameters of {} vary together along a curve, as those of a long lens do: the stated errors hold for "
    "pixels and places; regions of several parameters are larger than their covariance says."
)


@dataclass(frozen=True)
class Verdict:
    """A reason not to trust a calibration.

    Attributes:
        kind: ``UNOBSERVABLE`` (the data cannot determine some parameters) or ``MISFIT`` (the stated noise cannot
            explain the residuals).
        parameters: The parameters concerned.
        reason: What is wrong, a sentence.
        advice: What to do about it, a sentence.
        lens: Lens model to take instead; empty: none.
    """

    kind: str
    parameters: tuple[str, ...]
    reason: str
    advice: str
    lens: str = ""

    def __str__(self) -> str:
        """The verdict as text."""
        return f"{self.kind}: {self.reason} {self.advice}"


@dataclass(frozen=True)
class Rejection:
    """Observation left out of the estimate.

    Attributes:
        pose: Name of the pose.
        camera: Name of the camera; empty: the whole pose.
        reason: Why, a sentence.
        sigmas: Mahalanobis distance from the prediction.
    """

    pose: str
    camera: str
    reason: str
    sigmas: float


@dataclass(frozen=True)
class CameraEstimate:
    """One calibrated camera.

    Attributes:
        name: Name of the camera.
        model: Intrinsics, lens and pose.
        covariance: Covariance of :func:`im_calibration.estimation.unknowns.camera_parameters`, shape (k, k).
        spots_used: Number of spots that count.
        rms_px: RMS length of their residuals [px].
        curvature: How far the second order moves the parameters within their covariance, in standard deviations.
    """

    name: str
    model: CameraModel
    covariance: Array
    spots_used: int
    rms_px: float
    curvature: float

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the parameters, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True)
class TargetPlace:
    """Where the target of a robot and its cameras is.

    Attributes:
        frame: ``link``, if the target is on it, or ``base``.
        transform: Target -> frame, shape (4, 4) [-], [m].
        covariance: Of a turn about the frame's axes and origin [rad] and a shift [m], shape (6, 6).
    """

    frame: str
    transform: Array
    covariance: Array


@dataclass(frozen=True)
class Calibration:
    """Joint estimate of all cameras; arrays are in the order of the problem.

    Attributes:
        cameras: The c cameras.
        led_offset_error: Estimated error of the nominal LED offset, wrist frame, shape (3,) [m].
        joint_offsets: Estimated constant joint offsets, shape (k,) [rad].
        parameter_names: Name of each unknown.
        covariance: Covariance of all unknowns, shape (size, size).
        chi2: Squared Mahalanobis length of the residuals of the used spots and of the priors.
        dof: Degrees of freedom of `chi2`.
        p_value: Probability of a `chi2` this large or larger if the model and the noise are as stated.
        lens_prior_chi2: The part of `chi2` by which the lenses differ from usual ones.
        used: Which spots count, shape (c, n).
        residuals: Measured minus predicted spots, NaN where not seen, shape (c, n, 2) [px].
        residual_covariances: Their covariances by image and position noise, shape (c, n, 2, 2) [px^2].
        led_positions: LED positions by the robot, offsets corrected, shape (n, 3) [m].
        rejections: What was left out, and why.
        verdicts: Reasons not to trust the result; empty for a good one.
        expected: Errors to expect in the workspace.
        images: Errors to expect over the image of each camera.
        checks: How well parts of the data predict each other.
        scale: What known lengths say about the robot's scale; None without any.
        noise: What is known about the noise.
        neighbours: Whether the residuals are noise.
        cause: What data that fit no camera may be instead, a sentence; empty: nothing is known.
        arm_error_m: Standard deviation of each coordinate of the smooth error of the arm, over the poses [m].
        left_out: Reasons why cameras of the problem are not in `cameras`, one each.
        views: Views of a target of which points count; 0: of lights.
        target: Where the target of a robot is; None: there is no robot, or no target.

    >>> [round(float(focal)) for focal in np.diag(calibration.cameras[0].model.K)[:2]], calibration.points_used
    ([600, 600], 40)
    """

    cameras: tuple[CameraEstimate, ...]
    led_offset_error: Array
    joint_offsets: Array
    parameter_names: tuple[str, ...]
    covariance: Array
    chi2: float
    dof: int
    p_value: float
    lens_prior_chi2: float
    used: Mask
    residuals: Array
    residual_covariances: Array
    led_positions: Array
    rejections: tuple[Rejection, ...]
    verdicts: tuple[Verdict, ...]
    expected: CalibrationError
    images: tuple[ImageError, ...]
    checks: Checks
    scale: Scale | None
    noise: Noise
    neighbours: Neighbours
    cause: str
    arm_error_m: float
    left_out: tuple[Verdict, ...] = ()
    views: int = 0
    target: TargetPlace | None = None

    def moved(self, by: Array) -> "Calibration":
        """Return the same calibration in a world with another origin: all places have ``by`` added, shape (3,) [m].

        A rotation of a camera then turns the world about another point, so that errors of rotations become errors of
        translations: with x = exp(w) R X + t, ``t - R by`` moves by ``(R by) x w`` more than t.
        """
        cameras, blocks = [], []
        for camera in self.cameras:
            rotated = camera.model.R_cam_base @ by
            block = np.eye(len(camera.covariance))
            block[-3:, -6:-3] = cross_matrix(rotated)
            model = replace(camera.model, t_cam_base=camera.model.t_cam_base - rotated)
            cameras.append(replace(camera, model=model, covariance=block @ camera.covariance @ block.T))
            blocks.append(block)
        whole = scipy.linalg.block_diag(*blocks, np.eye(len(self.covariance) - sum(map(len, blocks))))
        return replace(
            self,
            cameras=tuple(cameras),
            covariance=whole @ self.covariance @ whole.T,
            led_positions=self.led_positions + by,
            expected=replace(self.expected, points=self.expected.points + by),
        )

    @property
    def success(self) -> bool:
        """Whether there is each camera of the problem, and nothing speaks against using them."""
        return self.usable and not self.left_out

    @property
    def usable(self) -> bool:
        """Whether nothing speaks against using the cameras that there are."""
        return not self.verdicts

    @property
    def camera_covariance(self) -> CameraCovariance:
        """How well all cameras are known together, offsets left to vary."""
        size = sum(len(camera.covariance) for camera in self.cameras)
        return CameraCovariance(self.parameter_names[:size], self.covariance[:size, :size])

    @property
    def points_used(self) -> int:
        """Number of poses of which at least one spot counts."""
        return int(self.used.any(axis=0).sum())

    @property
    def chi2_per_dof(self) -> float:
        """Reduced chi-square; 1 on average for a correct model, NaN without redundancy."""
        return self.chi2 / self.dof if self.dof > 0 else float("nan")

    @property
    def p_value_of_data(self) -> float:
        """Same as `p_value`, but of the data alone: a lens unlike others is no evidence against the data."""
        return chance_of(self.chi2 - self.lens_prior_chi2, self.dof)

    @property
    def standard_deviations(self) -> Array:
        """Standard deviation of each unknown, shape (size,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def message(self) -> str:
        """The outcome in a few sentences."""
        misfit = any(verdict.kind == "MISFIT" for verdict in self.verdicts)
        if self.cause:  # then it is not the noise
            return self.outcome
        condition = "If nothing else is wrong: " if misfit and self.noise.remark else ""
        pattern = self.neighbours.remark if misfit or self.noise.estimated else ""
        arm = _ARM.format(1e3 * self.arm_error_m) if self.arm_error_m else ""
        if any(self.neighbours.clause in verdict.reason for verdict in self.verdicts):
            pattern = ""  # said there, as one reason with the lens
        missing = " ".join(f"Left out: {each.reason} {each.advice}" for each in self.left_out)
        known = zip(self.cameras, self.images, strict=True)
        rims = " ".join(f"{camera.name}: {image.told}." for camera, image in known if image.told and self.usable)
        bent = [camera.name for camera in self.cameras if camera.curvature > _CURVED and self.usable]
        curve = _CURVE.format(", ".join(bent)) if bent else ""
        parts = (self.outcome, rims, curve, missing, f"{condition}{self.noise.remark}", arm, pattern)
        return " ".join(text for text in parts if text)

    @property
    def outcome(self) -> str:
        """The outcome in a sentence or two, a verdict with advice."""
        if self.verdicts:
            return " ".join(_told(kind, self.verdicts) for kind in dict.fromkeys(v.kind for v in self.verdicts))
        names = ", ".join(camera.name for camera in self.cameras)
        told = (
            f"{self.points_used} points of a target in {self.views} views"
            if self.views
            else f"{self.points_used} poses"
        )
        text = f"Calibrated {names} from {told}"
        errors = [f"{self.expected.reprojection_rms_px:.3f} px", f"{self.expected.triangulation_rms_mm:.2f} mm"]
        known = " and ".join(error for error in errors if not error.startswith("nan"))
        return f"{text}; expect {known} RMS in the workspace." if known else f"{text}; none of them sees the workspace."


def chance_of(chi2: float, dof: int) -> float:
    """Return the probability of a chi-square equally large or larger, NaN without redundancy."""
    return float(chi2_beyond(chi2, dof)) if dof > 0 else float("nan")


def _told(kind: str, verdicts: tuple[Verdict, ...]) -> str:
    """Join all verdicts of a kind to one text; repeated advice is given once."""
    these = [verdict for verdict in verdicts if verdict.kind == kind]
    return f"{kind}: {' '.join(dict.fromkeys([v.reason for v in these] + [v.advice for v in these]))}"
