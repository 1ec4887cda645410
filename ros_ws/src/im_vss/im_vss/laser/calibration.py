"""Pose and mirrors of the laser scanner from spots in the world.

Each spot must lie on its beam. What is left over, across the beam, is weighted by the covariance of the spot and by the
mirrors' repeatability; gains, offset and gap are also held by the tolerances of the data sheet. The maximum of the
posterior is found by least squares (Levenberg and Marquardt).

All spots are seen through the same calibration of the cameras, whose errors move them together. The scanner is fitted
to the spots as these cameras see them, so that what they see is what it hits; its covariance is the inverse of the
information, plus what the cameras' errors move the estimate by. The part of those errors that no scanner could make is
taken out of the misfit, as far as the cameras' covariance makes it likely.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from im_cell.laser_model import LaserModel
from im_cell.robot import LaserScanner
from im_cell.rotations import matrix_of_vector
from im_core.config import Model
from im_vss.stereo import Point

Array = NDArray[np.float64]

PARAMETERS = ("turn x", "turn y", "turn z", "x", "y", "z", "gain of mirror 1", "gain of mirror 2", "offset", "gap")
"""In this order: turn of the scanner in the world [rad], position [m], gains [-], offset of mirror 1 [rad], gap [m]."""
_POSE = 6
_ROBUST_LOSSES = ("soft_l1", "cauchy")
"""From what has one minimum to what hardly hears gross errors."""
_MOST_ROUNDS = 6
"""Of the fit by the spots in use, and of the choice of those by the fit."""
_MOST_EVALUATIONS = 200
_STEP = 1e-5
"""Of central differences, relative to what each parameter may be off."""
_NOTHING = 1e-14
"""Information below this, relative to the most, is rounding."""


class CalibrationGates(Model):
    """When a calibration of the scanner is good enough.

    Attributes:
        fewest: Spots that it takes.
        depth: Least standard deviation of the spots across the plane that fits them best [m].
        position_sd: Largest standard deviation of the scanner's position [m].
        chi2_per_dof: Largest misfit [-].
        outlier: Farthest a spot may be off its beam, in standard deviations.
        share: Least share of the spots that must be nearer [-].
    """

    fewest: int = Field(ge=6)
    depth: float = Field(gt=0.0)
    position_sd: float = Field(gt=0.0)
    chi2_per_dof: float = Field(gt=1.0)
    outlier: float = Field(gt=3.0)
    share: float = Field(gt=0.0, le=1.0)


@dataclass(frozen=True)
class LaserSpot:
    """Spot: reported angles of the mirrors, shape (2,) [rad], and the images in two cameras."""

    angles: Array
    point: Point


@dataclass(frozen=True)
class LaserCalibration:
    """Calibration of a scanner by spots.

    Attributes:
        model: The estimate.
        covariance: Of :data:`PARAMETERS`, shape (10, 10).
        verdicts: Why it cannot be used; empty if it can.
        rms_m: Of the distances of the spots used from their beams [m].
        chi2_per_dof: Misfit [-].
        used: For each spot, whether it was used, shape (n,).
        off: For each spot, how far it is off its beam, in standard deviations, shape (n,).
    """

    model: LaserModel
    covariance: Array
    verdicts: tuple[str, ...]
    rms_m: float
    chi2_per_dof: float
    used: NDArray[np.bool_]
    off: Array


def calibrate(
    sheet: LaserScanner, spots: Sequence[LaserSpot], cameras: Array, gates: CalibrationGates
) -> LaserCalibration:
    """Estimate pose and mirrors.

    Args:
        sheet: The scanner as drawn, with its tolerances.
        spots: What was seen, all by the same cameras.
        cameras: Covariance of the parameters by which the spots move, see :class:`im_vss.stereo.Point`, shape (p, p).
        gates: What is good enough.

    Returns:
        The estimate; where the spots do not suffice, the best there is, with a verdict.
    """
    used = np.ones(len(spots), dtype=np.bool_)
    rotation, position = sheet.pose()
    model = LaserModel(rotation, position, sheet.gap)
    problem = _Problem(sheet, spots, cameras)
    if len(spots) < gates.fewest:
        verdict = f"UNOBSERVABLE: {len(spots)} spots are fewer than {gates.fewest}; take more, at different depths"
        unknown = np.full((len(PARAMETERS), len(PARAMETERS)), np.nan)
        return LaserCalibration(
            model, unknown, (verdict,), float("nan"), float("nan"), used, np.full(len(spots), np.nan)
        )
    for loss in _ROBUST_LOSSES:
        model = problem.solve(model, used, problem.by_all, loss)
    within = problem.deviations(model) <= gates.outlier
    for _ in range(_MOST_ROUNDS):
        used = within if within.sum() >= gates.fewest else used
        model = problem.solve(model, used, problem.by_spots)
        judged = problem.judge(model, used, gates.outlier)
        within = judged.off <= gates.outlier
        if np.array_equal(within, used):
            break
    across = problem.across(model)[used]
    dof = 2 * int(used.sum()) - _POSE  # the data sheet gives as many numbers as the mirrors have parameters
    chi2 = judged.chi2 / dof
    rms = float(np.sqrt((across**2).sum(axis=1).mean()))
    places = np.array([spot.point.position for spot, use in zip(spots, used, strict=True) if use])
    verdicts = _verdicts(places, len(spots), judged.by_spots, chi2, gates)
    return LaserCalibration(model, judged.covariance, verdicts, rms, chi2, used, judged.off)


def _verdicts(places: Array, offered: int, covariance: Array, chi2: float, gates: CalibrationGates) -> tuple[str, ...]:
    """Return the reasons against an estimate from spots, shape (n, 3) [m], chosen among the offered ones.

    `covariance` is what these spots leave open, shape (10, 10): that of the cameras no further spot can mend.
    """
    found: list[str] = []
    if len(places) < gates.share * offered:
        found.append(
            f"MISFIT: only {len(places)} of {offered} spots lie on their beams, at least {gates.share:.0%} must; look "
            "at what the rejected ones were, and calibrate the cameras anew"
        )
    depth = float(np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(places)))
    if depth < gates.depth:
        found.append(
            f"UNOBSERVABLE: all spots lie within {1e3 * depth:.1f} mm (standard deviation) of one plane, at least "
            f"{1e3 * gates.depth:g} mm are needed to tell the scanner's place from the gains of its mirrors; take "
            "spots at other depths"
        )
    deviation = np.sqrt(np.diag(covariance)[3:_POSE])
    poor = [f"{name} {1e3 * sd:.1f} mm" for name, sd in zip("xyz", deviation, strict=True) if sd > gates.position_sd]
    if poor:
        found.append(
            f"UNOBSERVABLE: standard deviation of the scanner's position: {', '.join(poor)}, at most "
            f"{1e3 * gates.position_sd:g} mm are allowed; take more spots, over wider angles and at other depths"
        )
    if chi2 > gates.chi2_per_dof:
        found.append(
            f"MISFIT: chi2 per degree of freedom is {chi2:.1f}, at most {gates.chi2_per_dof:g} are allowed; calibrate "
            "the cameras anew"
        )
    return tuple(found)


@dataclass(frozen=True)
class _Judged:
    """Value of an estimate.

    Attributes:
        by_spots: Its covariance by the noise of spots and mirrors, shape (10, 10).
        covariance: By that and the cameras, shape (10, 10).
        chi2: Misfit, without what the likeliest error of the cameras explains [-].
        off: How far each spot is off, without the same, in standard deviations, shape (n,).
    """

    by_spots: Array
    covariance: Array
    chi2: float
    off: Array


class _Problem:
    """Spots and data sheet, as a least squares problem."""

    def __init__(self, sheet: LaserScanner, spots: Sequence[LaserSpot], cameras: Array) -> None:
        values, axes = np.linalg.eigh(cameras)
        root = axes[:, values > 0.0] * np.sqrt(values[values > 0.0])
        self._angles = np.array([spot.angles for spot in spots]).reshape(-1, 2)
        self._places = np.array([spot.point.position for spot in spots]).reshape(-1, 3)
        self.by_spots = np.array([spot.point.by_spots for spot in spots]).reshape(-1, 3, 3)
        self.by_all = np.array([spot.point.covariance for spot in spots]).reshape(-1, 3, 3)
        self._common = np.array([spot.point.by_cameras @ root for spot in spots]).reshape(len(spots), 3, root.shape[1])
        self._jitter = 2.0 * sheet.repeatability
        limits = sheet.tolerance
        self._expected = np.array([1.0, 1.0, 0.0, sheet.gap])
        self._tolerance = np.array([limits.gain, limits.gain, limits.offset, limits.gap])
        self._scale = np.concatenate((np.full(3, 0.01), np.full(3, 0.01), self._tolerance))

    def solve(self, start: LaserModel, used: NDArray[np.bool_], covariances: Array, loss: str = "linear") -> LaserModel:
        """Return the best model by the spots in use, shape (n,), with the given covariances, shape (n, 3, 3) [m^2]."""
        model = start
        for _ in range(2):  # weights depend on directions and distances, which hardly change
            whiten, base = self._whitening(model, covariances)[used], model

            def residuals(step: Array, base: LaserModel = base, whiten: Array = whiten) -> Array:
                moved = _moved(base, step)
                spots = np.einsum("nij,nj->ni", whiten, self._off(moved)[used]).ravel()
                return np.concatenate((spots, self._prior(moved)))

            fit = scipy.optimize.least_squares(
                residuals, np.zeros(len(PARAMETERS)), x_scale=self._scale, loss=loss,
                max_nfev=_MOST_EVALUATIONS, xtol=1e-12, ftol=1e-12,
            )  # fmt: skip
            model = _moved(base, fit.x)
        return model

    def deviations(self, model: LaserModel) -> Array:
        """Return the distance of each spot from the beam, in standard deviations by spots and cameras, shape (n,)."""
        whiten = self._whitening(model, self.by_all)
        return np.asarray(np.linalg.norm(np.einsum("nij,nj->ni", whiten, self._off(model)), axis=1))

    def judge(self, model: LaserModel, used: NDArray[np.bool_], outlier: float) -> _Judged:
        """Return covariance and fit of an estimate from the spots in use, shape (n,).

        To first order: with residuals r of unit variance, J their derivatives by the scanner and A by the independent
        errors z of the cameras, each of unit variance, z moves the estimate by ``-(J'J)^-1 J'A z`` and leaves
        ``(A - J (J'J)^-1 J'A) z`` in the residuals.
        """
        n, whiten = len(used), self._whitening(model, self.by_spots)

        def residuals(step: Array) -> Array:
            moved = _moved(model, step)
            return np.concatenate((np.einsum("nij,nj->ni", whiten, self._off(moved)).ravel(), self._prior(moved)))

        steps = np.diag(_STEP * self._scale)
        jacobian = np.stack([(residuals(step) - residuals(-step)) / (2.0 * _STEP) for step in steps], axis=1)
        common = np.zeros((len(jacobian), self._common.shape[2]))
        common[: 2 * n] = (whiten @ self._common).reshape(2 * n, -1)
        rows = np.append(np.repeat(used, 2), np.ones(len(self._expected), dtype=np.bool_))
        information, axes = np.linalg.eigh(jacobian[rows].T @ jacobian[rows])
        by_spots = (axes / np.maximum(information, _NOTHING * information[-1])) @ axes.T
        moved = by_spots @ jacobian[rows].T @ common[rows]
        units = np.outer(self._scale, self._scale)

        left, found = common - jacobian @ moved, residuals(np.zeros(len(PARAMETERS)))
        blocks, across = left[: 2 * n].reshape(n, 2, -1), found[: 2 * n].reshape(n, 2)
        alone = np.linalg.solve(np.eye(2) + blocks @ np.swapaxes(blocks, 1, 2), across[..., None])[..., 0]
        likely = used & (np.einsum("ni,ni->n", across, alone) <= outlier**2)
        believed = np.append(np.repeat(likely, 2), np.ones(len(self._expected), dtype=np.bool_))
        z = np.linalg.solve(
            np.eye(left.shape[1]) + left[believed].T @ left[believed], left[believed].T @ found[believed]
        )
        rest = found - left @ z
        off = np.linalg.norm(rest[: 2 * n].reshape(n, 2), axis=1)
        chi2 = float((rest[rows] ** 2).sum() + (z**2).sum())
        return _Judged(by_spots * units, (by_spots + moved @ moved.T) * units, chi2, off)

    def across(self, model: LaserModel) -> Array:
        """Return vectors from the beams to the spots, shape (n, 3) [m]."""
        return self._off(model)

    def _prior(self, model: LaserModel) -> Array:
        return np.asarray((np.array([*model.gain, model.offset, model.gap]) - self._expected) / self._tolerance)

    def _off(self, model: LaserModel) -> Array:
        origins, directions = model.rays(self._angles)
        way = self._places - origins
        return np.asarray(way - np.einsum("ni,ni->n", way, directions)[:, None] * directions)

    def _whitening(self, model: LaserModel, covariances: Array) -> Array:
        """Return a matrix for each spot to make the vector off the beam two unit normals, shape (n, 2, 3) [1/m].

        Args:
            model: The scanner.
            covariances: Of the spots, shape (n, 3, 3) [m^2].
        """
        origins, directions = model.rays(self._angles)
        distance = np.linalg.norm(self._places - origins, axis=1)
        basis = np.linalg.svd(directions[:, None, :])[2][:, 1:, :]
        seen = np.einsum("nij,njk,nlk->nil", basis, covariances, basis)
        seen = seen + (self._jitter * distance)[:, None, None] ** 2 * np.eye(2)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(seen)) @ basis)


def _moved(model: LaserModel, step: Array) -> LaserModel:
    """Return a model changed by a step in :data:`PARAMETERS`, shape (10,)."""
    return LaserModel(
        rotation=matrix_of_vector(step[:3]) @ model.rotation,
        position=model.position + step[3:_POSE],
        gain=(model.gain[0] + float(step[6]), model.gain[1] + float(step[7])),
        offset=model.offset + float(step[8]),
        gap=model.gap + float(step[9]),
    )
