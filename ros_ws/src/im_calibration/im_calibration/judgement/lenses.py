"""Sufficiency of the lens models: residuals against the place in the image, and predictions of another model.

The score test asks whether terms that a model has not would lower chi-square, without fitting them: with E the
derivatives of the images by such terms and J by the unknowns, their score ``E^T S^-1 r`` has the covariance
``E^T S^-1 E - E^T S^-1 J P J^T S^-1 E``. Source: Rao, "Large sample tests of statistical hypotheses" (1948). Where
it may be significant, other lens models are fitted, and the poses predicted from the others decide: Stone,
"Cross-validatory choice and assessment of statistical predictions" (1974).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.chi_squared import chi2_beyond
from im_calibration.estimation.covariance import covariance_of
from im_calibration.estimation.gates import TRUSTED_SHARE, Gated, predict_from_others
from im_calibration.estimation.projection import image
from im_calibration.estimation.residuals import camera_blocks
from im_calibration.estimation.search import best_explanation, first_explanation, unexplained
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.problem.problem import CalibrationProblem
from im_cell.lens import LENSES

Array = NDArray[np.float64]

_SUSPICIOUS, _UNLIKELY, _VERY_UNLIKELY = 0.05, 1e-3, 1e-6
_LOST = 1e-4  # share of a term's information that the fitted terms leave, below which they say the same
_WORST_SPOT = 30.0
_GAIN, _ONE_GAIN = 25.0, 10.0  # lower -2 log likelihood of held-out poses: of all suspected cameras, of one of them
_STEADY, _ONE_STEADY = 2.3, 2.0  # and in standard deviations, so that no few spots decide


@dataclass(frozen=True)
class LensFault:
    """Lens model with a remaining pattern in the residuals of a camera.

    Attributes:
        camera: Index of the camera.
        model: Name of the lens model.
        against: What the residuals depend on.
        chance: Probability that noise does that.
        better: Name of the model that predicts poses from the others better; empty: none does.
        held_out_px: Median error of these predictions with the model and with the better one [px].
        explains: Whether the better model leaves residuals that the stated noise explains.
    """

    camera: int
    model: str
    against: str
    chance: float
    better: str = ""
    held_out_px: tuple[float, float] = (np.nan, np.nan)
    explains: bool = False


def lens_faults(
    gated: Gated, problem: CalibrationProblem, layout: ParameterLayout, noise: float
) -> tuple[LensFault, ...]:
    """Find lens models with too few terms, or of the wrong kind.

    Where the residuals of a camera may hold a pattern, and of all cameras where the noise does not explain them, other
    lens models are tried: the score test alone would miss patterns whose worst spots were rejected.

    Args:
        gated: The estimate.
        problem: What it was made from.
        layout: Places of the unknowns.
        noise: Chi-square per degree of freedom, by which patterns of noise are larger.
    """
    patterns = [min(_patterns(gated, problem, layout, c, max(1.0, noise))) for c in range(layout.cameras)]
    explained = _explains(gated, problem)
    given = problem.given_intrinsics or (None,) * layout.cameras  # of one lens model, whatever another would do
    suspects = [
        c for c, (chance, _) in enumerate(patterns) if (chance < _SUSPICIOUS or not explained) and given[c] is None
    ]
    faults = [LensFault(c, problem.lens_models[c], against, chance) for c, (chance, against) in enumerate(patterns)]
    better = _with_better([faults[c] for c in suspects], gated, problem, layout) if suspects else ()
    if better and (explained or better[0].explains):
        return better
    return tuple(fault for fault in faults if explained and fault.chance < _VERY_UNLIKELY)


def _patterns(
    gated: Gated, problem: CalibrationProblem, layout: ParameterLayout, c: int, noise: float
) -> tuple[tuple[float, str], ...]:
    """Chance of the residuals' dependence on the distance from the middle of the image, and on the direction."""
    line, unknowns = gated.fit.linearisation, gated.fit.unknowns
    half = float(np.hypot(*problem.image_sizes[c])) / 2.0
    off = (image(unknowns, unknowns.led_positions(problem))[c] - unknowns.intrinsics[c, 2:4]) / half
    off = np.where(gated.used[c][:, None], off, 0.0)
    r2 = (off**2).sum(axis=1)[:, None]
    along = np.stack((off * r2**3, off * r2**4), axis=-1)
    x, y = r2 * [1.0, 0.0], r2 * [0.0, 1.0]
    across = np.stack((x, y, off * off[:, :1] * r2, off * off[:, 1:] * r2), axis=-1)
    covariance = covariance_of(gated.fit.information).matrix
    weights = np.linalg.inv(line.covariances)
    weighted = weights @ line.jacobians
    chances = []
    distance, direction = (f"the {what} from the middle of the image" for what in ("distance", "direction"))
    for terms, against in ((along, distance), (across, direction)):
        fields = np.zeros((*line.residuals.shape, terms.shape[-1]))
        fields[:, 2 * c : 2 * c + 2] = terms
        score = np.einsum("nia,nij,nj->a", fields, weights, line.residuals)
        own = np.einsum("nia,nij,njb->ab", fields, weights, fields)
        common = np.einsum("nia,nip->ap", fields, weighted)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
        values, vectors = np.linalg.eigh((own - common @ covariance @ common.T) * scale[:, None] * scale)
        kept = values > _LOST
        projected = (vectors.T @ (scale * score))[kept]
        statistic = float((projected**2 / values[kept]).sum()) / noise
        chances.append((float(chi2_beyond(statistic, kept.sum())) if kept.any() else 1.0, against))
    return tuple(chances)


def _with_better(
    suspects: list[LensFault], gated: Gated, problem: CalibrationProblem, layout: ParameterLayout
) -> tuple[LensFault, ...]:
    """Return the cameras with poses predicted significantly better by another lens model, with the best such model."""
    cameras = [fault.camera for fault in suspects]
    before = [_losses(gated, problem, layout, c) for c in cameras]
    best, least = list[LensFault](), -_GAIN
    before_unexplained = unexplained(gated, problem)
    for name in LENSES:
        models = tuple(name if c in cameras else model for c, model in enumerate(problem.lens_models))
        if models == problem.lens_models:
            continue
        other = replace(problem, lens_models=models)
        try:
            anew = first_explanation(other, ParameterLayout.of(other))
            if unexplained(anew, other) < before_unexplained:  # else no search makes it the better one
                anew = best_explanation(other, ParameterLayout.of(other), anew)
        except (DegenerateDataError, InconsistentDataError, np.linalg.LinAlgError):
            continue
        if not np.isfinite(anew.fit.chi2):
            continue
        after = [_losses(anew, other, ParameterLayout.of(other), c) for c in cameras]
        gains = [now - then for (then, _), (now, _) in zip(before, after, strict=True)]
        together = np.concatenate(gains)
        if together.sum() < least and _deviation(together) < -_STEADY:
            least, explains = float(together.sum()), _explains(anew, other)
            best = [
                replace(fault, better=name, held_out_px=(then, now), explains=explains)
                for fault, (_, then), (_, now), gain in zip(suspects, before, after, gains, strict=True)
                if fault.model != name and gain.sum() < -_ONE_GAIN and _deviation(gain) < -_ONE_STEADY
            ]
    return tuple(best)


def _deviation(gain: Array) -> float:
    """Return the sum of a sample, divided by the standard deviation of the sum."""
    return float(gain.sum() / max(float(gain.std()) * len(gain) ** 0.5, 1e-300))


def _losses(gated: Gated, problem: CalibrationProblem, layout: ParameterLayout, c: int) -> tuple[Array, float]:
    """How badly each spot of a camera is predicted from the other poses, shape (m,), and the median error [px].

    Spots of one reading of the robot are off together, and say once what they say: their mean is taken.
    """
    prediction = predict_from_others(gated.fit, problem, layout, gated.used)
    seen = problem.detected[c]
    errors = prediction.errors[seen, 2 * c : 2 * c + 2]
    spread = camera_blocks(prediction.covariances)[c][seen]
    squared = (errors * np.linalg.solve(spread, errors[..., None])[..., 0]).sum(axis=1)
    error = float(np.sqrt(np.median((errors**2).sum(axis=1))))
    losses = np.minimum(squared, _WORST_SPOT) + np.linalg.slogdet(spread)[1]
    if problem.readings:
        reading = np.unique(np.array(problem.readings)[seen], return_inverse=True)[1]
        losses = np.bincount(reading, losses) / np.bincount(reading)
    return losses, error


def _explains(gated: Gated, problem: CalibrationProblem) -> bool:
    """Check whether a fit agrees with most spots, and the noise explains the residuals."""
    layout = ParameterLayout.of(problem)
    prior = layout.prior(gated.fit.unknowns).lens_chi2
    dof = 2 * int(gated.used.sum()) - layout.free_size
    believed = np.all(gated.used.sum(axis=1) >= TRUSTED_SHARE * problem.detected.sum(axis=1))
    return bool(believed and dof > 0 and chi2_beyond(gated.fit.chi2 - prior, dof) > _UNLIKELY)
