"""The noise of image and robot, as stated and as the residuals say."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.noise import Factor, NoiseFactors
from im_calibration.problem.problem import NOISE_SOURCES, CalibrationProblem

Mask = NDArray[np.bool_]

UNLIKELY = 1e-3
"""Chance of data below which the stated noise is said to be wrong."""


@dataclass(frozen=True)
class Noise:
    """Known facts about the noise.

    Attributes:
        factors: What the residuals say about the stated noise.
        scale: Factors by which the stated standard deviations of image and robot were multiplied for the estimate.
        estimated: Whose noise was estimated, of :data:`im_calibration.problem.problem.NOISE_SOURCES`.
        image_px: Root mean square of the stated standard deviations of the coordinates of the used spots [px].
        robot_m: The same of the coordinates of the positions, of a target's that of the link's place alone [m].
    """

    factors: NoiseFactors
    scale: tuple[float, float]
    estimated: tuple[str, ...]
    image_px: float
    robot_m: float

    @property
    def remark(self) -> str:
        """Remark on the noise, in sentences; empty if the noise is stated, and found as stated."""
        if self.estimated:
            return self._found
        return "" if self.factors.p_value >= UNLIKELY else self._wrong

    @property
    def _wrong(self) -> str:
        """By how much the stated noise is wrong."""
        each = (("image", self.factors.image), ("robot", self.factors.robot))
        details = [f"that of the {name} {_error(factor)}" for name, factor in each if not _holds_one(factor)]
        if not _holds_one(self.factors.common):
            details = details or ["image and robot cannot be told apart"]
            text = f"The stated noise is about {_error(self.factors.common)}: {', '.join(details)}."
        elif details:
            text = f"The stated noise is wrong: {', '.join(details)}."
        else:
            return ""
        return f"{text} Correct it, or have it estimated."

    @property
    def _found(self) -> str:
        """Text on the found noise."""
        factors, told = self.factors, []
        if not factors.common.determined:
            return "The data are too few to estimate the noise; it is taken as it was given."
        if "image" in self.estimated:
            told.append(f"of the image {_size(factors.image, self.image_px)} px")
        if "robot" in self.estimated and self.robot_m:
            told.append(f"of the robot {_size(factors.robot, 1e3 * self.robot_m)} mm")
        text = f"Estimated noise: {', '.join(told)}"
        if len(told) < len(NOISE_SOURCES) or factors.image.determined or factors.robot.determined:
            return f"{text}."
        return f"{text}; which of them it is cannot be told from these data, and makes no difference to the cameras."


def noise_of(problem: CalibrationProblem, used: Mask, factors: NoiseFactors, scale: tuple[float, float]) -> Noise:
    """Collect the known facts about the noise.

    Args:
        problem: The observations, with the noise that is stated.
        used: Which spots count, shape (c, n).
        factors: What the residuals say about it.
        scale: Factors by which it was multiplied for the estimate.
    """
    spots = np.trace(problem.spot_covariances[used], axis1=1, axis2=2) / 2.0
    counts, roots = used.any(axis=0), None if problem.placements is None else problem.placements.roots
    if roots is None:
        positions = np.trace(problem.position_covariances[counts], axis1=1, axis2=2) / 3.0
    else:  # what the link's turn does to a point grows with its distance: no arm is judged by that
        positions = (roots[counts, :, :3] ** 2).sum(axis=(1, 2)) / 3.0
    image_px, robot_m = (float(np.sqrt(variances.mean())) for variances in (spots, positions))
    return Noise(factors, scale, problem.noise_to_estimate, image_px, robot_m)


def _holds_one(factor: Factor) -> bool:
    return factor.low <= 1.0 <= factor.high


def _error(factor: Factor) -> str:
    """Return the text ``3.1x too large (2.9x to 3.3x)``, or ``at least 2.9x too large``."""
    if factor.high < 1.0:
        least, most, how = 1.0 / factor.high, _inverse(factor.low), "too large"
    else:
        least, most, how = factor.low, factor.high, "too small"
    if not np.isfinite(most):
        return f"at least {least:.2g}x {how}"
    return f"{np.exp(abs(np.log(factor.value))):.2g}x {how} ({least:.2g}x to {most:.2g}x)"


def _inverse(value: float) -> float:
    return 1.0 / value if value > 0.0 else float("inf")


def _size(factor: Factor, stated: float) -> str:
    """Return the text ``0.21 (0.19 to 0.24)``, or ``at most 0.24``."""
    value, low, high = (f"{stated * each:.2g}" for each in (factor.value, factor.low, factor.high))
    if factor.determined:
        return f"{value} ({low} to {high})"
    if factor.low > 0.0:
        return f"at least {low}"
    return f"at most {high}" if np.isfinite(factor.high) else "unknown"
