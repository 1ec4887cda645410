"""Scale of the robot: known lengths against the same lengths measured by the calibrated cameras.

Cameras calibrated by a robot whose links are 1 % too long measure 1 % too long, and no residual shows it. A pair of
LEDs at a known distance L, triangulated at a distance d, says that the scale is wrong by ``L / d - 1``; what all pairs
say is combined by generalised least squares, the errors of the cameras being common to all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_beyond, chi2_limit
from im_calibration.estimation.gates import FALSE_ALARM
from im_calibration.estimation.projection import project
from im_calibration.estimation.unknowns import Unknowns
from im_calibration.judgement.expected import camera_blocks_of
from im_calibration.problem.problem import KnownLengths

Array = NDArray[np.float64]

_STEPS = 50
_CONVERGED_M = 1e-9
_APART_SIGMAS = 3.0


@dataclass(frozen=True)
class Scale:
    """Scale: comparison of known lengths with the metre of the robot.

    Attributes:
        error: True lengths over those in the robot's metres, less 1.
        standard_deviation: Of `error`, by the spots, the lengths' own uncertainty and the covariance of the cameras.
        p_value: Probability of an error this large or larger if the robot's scale is right.
        lengths_used: Lengths whose ends two cameras see and agree about.
        lengths_given: All lengths.
        agreement: Probability of lengths that differ among each other this much or more; NaN for one length.
    """

    error: float
    standard_deviation: float
    p_value: float
    lengths_used: int
    lengths_given: int
    agreement: float


@dataclass(frozen=True)
class _Points:
    """Triangulated points: positions, the good ones, and the effect of noise and camera errors on the points."""

    places: Array
    good: NDArray[np.bool_]
    covariances: Array
    by_cameras: Array


def measure_scale(unknowns: Unknowns, covariance: Array, lengths: KnownLengths, guess: Array) -> Scale | None:
    """Compare known lengths with the lengths measured by the cameras.

    Args:
        unknowns: The calibrated cameras.
        covariance: Covariance of all unknowns, cameras first, shape (size, size).
        lengths: The known lengths.
        guess: Some place in view of the cameras, shape (3,) [m].

    Returns:
        The scale; None where no length can be used.
    """
    c, k = len(lengths.spots), len(lengths.lengths)
    if not k:
        return None
    order = np.lexsort(np.nan_to_num(np.swapaxes(lengths.spots, 0, 1)).reshape(k, -1).T)  # sums in any order differ
    size = sum(10 + lens.estimated for lens in unknowns.lenses)
    cameras = covariance[:size, :size]
    points = _triangulate(
        unknowns,
        cameras,
        lengths.spots[:, order].reshape(c, 2 * k, 2),
        lengths.spot_covariances[:, order].reshape(c, 2 * k, 2, 2),
        guess,
    )
    places, spreads = points.places.reshape(k, 2, 3), points.covariances.reshape(k, 2, 3, 3)
    apart = ((places[:, 1] - places[:, 0]) ** 2).sum(axis=1)
    noise = np.trace(spreads.sum(axis=1), axis1=1, axis2=2)
    used = points.good.reshape(k, 2).all(axis=1) & (apart > _APART_SIGMAS**2 * noise)  # else it is one
    if not used.any():
        return None
    ends = places[used]
    measured = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    along = (ends[:, 1] - ends[:, 0]) / measured[:, None]
    moved = points.by_cameras.reshape(k, 2, 3, -1)[used]
    by_cameras = np.einsum("ni,nip->np", along, moved[:, 1] - moved[:, 0])
    noise = np.einsum("ni,neij,nj->n", along, spreads[used], along)
    true, own = np.array(lengths.lengths)[order][used], lengths.standard_deviations[order][used]
    ratio = true / measured
    spread = np.diag(own**2 + ratio**2 * noise) + ratio[:, None] * (by_cameras @ cameras @ by_cameras.T) * ratio
    # lengths share the errors of the cameras: the whole matrix weighs
    weights = np.linalg.inv(spread / np.outer(measured, measured))
    precision = float(weights.sum())
    error = float(weights.sum(axis=0) @ (ratio - 1.0)) / precision
    left = ratio - 1.0 - error
    n = int(used.sum())
    return Scale(
        error=error,
        standard_deviation=precision**-0.5,
        p_value=float(chi2_beyond(error**2 * precision, 1)),
        lengths_used=n,
        lengths_given=k,
        agreement=float(chi2_beyond(left @ weights @ left, n - 1)) if n > 1 else float("nan"),
    )


def _triangulate(unknowns: Unknowns, cameras: Array, spots: Array, spot_covariances: Array, guess: Array) -> _Points:
    """Triangulate points, spots weighted by noise; good if two cameras agree within noise and camera errors."""
    c, m = spots.shape[:2]
    seen = ~np.isnan(spots[..., 0])
    weights = np.linalg.inv(np.where(seen[..., None, None], spot_covariances, np.eye(2)))
    weights = np.where(seen[..., None, None], weights, 0.0)
    good = seen.sum(axis=0) >= 2
    places = np.tile(np.asarray(guess, dtype=float), (m, 1))
    for _ in range(_STEPS):
        pixels, by_point, by_camera = project(unknowns, places)
        good &= np.all(np.isfinite(pixels) | ~seen[..., None], axis=(0, 2))
        counts = (seen & good)[..., None, None]
        by_point = np.where(counts, by_point, 0.0)
        by_camera = tuple(np.where(count, one, 0.0) for count, one in zip(counts, by_camera, strict=True))
        residuals = np.where(counts[..., 0], spots - pixels, 0.0)
        normal = np.einsum("cmai,cmab,cmbj->mij", by_point, weights, by_point)
        normal = np.where(good[:, None, None], normal, np.eye(3))
        pull = np.linalg.solve(normal[None], np.swapaxes(by_point, 2, 3) @ weights)
        step = np.einsum("cmia,cma->mi", pull, residuals)
        if np.abs(step).max(initial=0.0) < _CONVERGED_M:
            break
        places = places + step
    moved = np.concatenate([-pull[i] @ by_camera[i] for i in range(c)], axis=2)
    good &= _agree(residuals, by_point, by_camera, spot_covariances, cameras, seen)
    return _Points(places, good, np.linalg.inv(normal), moved)


def _agree(
    residuals: Array, by_point: Array, by_camera: Sequence[Array], noise: Array, cameras: Array, seen: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Check whether the spots of each point can be of one place, given spot noise and camera errors, shape (m,)."""
    c, m = seen.shape
    rows = np.swapaxes(by_point, 0, 1).reshape(m, 2 * c, 3)
    blocks = camera_blocks_of(by_camera)
    errors = np.zeros((m, 2 * c, blocks[-1].stop))
    spread = np.zeros((m, 2 * c, 2 * c))
    for i in range(c):
        pair = slice(2 * i, 2 * i + 2)
        errors[:, pair, blocks[i]] = by_camera[i]
        spread[:, pair, pair] = np.where(seen[i][:, None, None], noise[i], np.eye(2))
    # A place that may be anywhere explains all of a residual but what the cameras say against each other.
    spread = spread + errors @ cameras @ np.swapaxes(errors, 1, 2) + rows @ np.swapaxes(rows, 1, 2)
    stacked = np.swapaxes(residuals, 0, 1).reshape(m, 2 * c, 1)
    distance = (stacked * np.linalg.solve(spread, stacked)).sum(axis=(1, 2))
    limits = chi2_limit(FALSE_ALARM, np.maximum(1, 2 * seen.sum(axis=0) - 3))
    return np.asarray(distance <= limits)
