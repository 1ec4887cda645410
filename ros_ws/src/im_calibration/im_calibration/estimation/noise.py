"""Variance components: factors between actual and stated noise of image and robot, and the factors' certainty.

The residuals of a pose have the covariance ``theta_u U + theta_x X``, U stated for the spots and X what the stated
covariance of the position makes of them. The factors maximise the restricted likelihood, in which the unknowns are
integrated out, so that their number does not make the noise look small. Fisher scoring on it is what Helmert's and
Foerstner's estimators of variance components iterate to. Intervals are of the profile likelihood, since a factor may be
bounded from one side only: where a robot is far better than what its images show, data say "at most".

Sources: Foerstner, "Ein Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten" (1979); Harville, "Maximum
likelihood approaches to variance component estimation" (1977); Venzon and Moolgavkar, "A method for computing profile-
likelihood-based confidence intervals" (1988).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from im_calibration.estimation.chi_squared import chi2_beyond, chi2_limit
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import NOISE_SOURCES, CalibrationProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHANCE = 0.95
_LIMIT = 2.0 * np.log(1e4)  # of the logarithm of a variance factor
_STEPS, _CONVERGED, _HALVINGS = 60, 1e-6, 8
_FAR = 6.0
_ROUNDING = 1e-12
_IMAGE, _ROBOT = np.array([True, False]), np.array([False, True])
_BOTH = np.array([True, True])


@dataclass(frozen=True)
class Factor:
    """Standard deviation of a noise over the stated one.

    Attributes:
        value: Of greatest likelihood; 0 and infinity stand for beyond 10,000.
        low: Lower end of the 95 % interval; 0: the data set no lower bound.
        high: Upper end of it; infinity: the data set no upper bound.
    """

    value: float
    low: float
    high: float

    @property
    def determined(self) -> bool:
        """Whether the data bound the factor from both sides."""
        return bool(self.low > 0.0 and np.isfinite(self.high))


@dataclass(frozen=True)
class NoiseFactors:
    """Findings from the residuals about the stated noise.

    Attributes:
        image: Factor on the noise of the spots.
        robot: Factor on the noise of the positions.
        common: Factor on both, if it is the same.
        p_value: Probability of data that speak this much or more against the stated noise if it is right.
        scale: Factors on image and robot to go on with, see :func:`noise_factors`.
    """

    image: Factor
    robot: Factor
    common: Factor
    p_value: float
    scale: tuple[float, float]

    @property
    def separable(self) -> bool:
        """Whether the data separate the noise of the image from the noise of the robot."""
        return self.image.determined and self.robot.determined


class NoiseLikelihood:
    """Restricted likelihood of the variance factors, linearised at a fit.

    What the positions of a reading are off together is integrated out, as what each is off by itself.

    Args:
        unknowns: The fit.
        problem: The observations.
        layout: Places of the unknowns.
        used: Which spots count, shape (c, n).
        bent: Whether the variance of each kind of the arm's smooth error is a factor as well, behind those of image and
            robot; otherwise they are as stated.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        problem: CalibrationProblem,
        layout: ParameterLayout,
        used: Mask,
        *,
        bent: bool = False,
    ) -> None:
        line, shared = linearise(unknowns, problem, layout, used), layout.shared_slice
        kept = np.r_[0 : shared.start, shared.stop : layout.size]
        own = line.by_point @ problem.own_covariances @ np.swapaxes(line.by_point, 1, 2)
        together = problem.by_reading(line.by_point @ problem.shared_roots)
        lower = np.linalg.cholesky(problem.joined(line.covariances - own, 1.0))
        half = np.linalg.solve(lower, problem.joined(own, 0.0) + together @ np.swapaxes(together, 1, 2))
        values, axes = np.linalg.eigh(np.linalg.solve(lower, np.swapaxes(half, 1, 2)))
        turned = np.swapaxes(axes, 1, 2)
        least = _ROUNDING * values[:, -1:] if together.any() else 0.0  # a reading moves many spots in few ways
        robot = np.where(values > least, values, 0.0).ravel()  # variance over that by the image
        residuals = problem.by_reading(line.residuals + line.jacobians[:, :, shared] @ unknowns.shared_errors)
        residuals = (turned @ np.linalg.solve(lower, residuals[..., None])).ravel()
        jacobians = turned @ np.linalg.solve(lower, problem.by_reading(line.jacobians[:, :, kept]))
        self._beside, self._unused = 0.0, len(robot) - 2 * int(used.sum())
        jacobians, residuals, robot = self._compressed(jacobians.reshape(len(robot), -1), residuals, robot)
        prior = layout.prior(unknowns)
        known, pull = prior.information[np.ix_(kept, kept)], -prior.gradient[kept]
        self._parts = np.stack((np.ones_like(robot), robot))
        if bent and problem.arm_error is not None:  # its coefficients are seen as 0, up to a noise of each kind
            arm = np.arange(len(kept) - layout.arm, len(kept))
            known[arm, arm], pull[arm] = 0.0, 0.0
            jacobians = np.concatenate((jacobians, np.eye(len(kept))[arm]))
            residuals = np.concatenate((residuals, -unknowns.arm_error))
            kinds = np.eye(problem.arm_error.kinds.max() + 1)[:, problem.arm_error.kinds]
            self._parts = scipy.linalg.block_diag(self._parts, kinds)
        self._residuals = residuals
        weighted = jacobians / self._parts.sum(axis=0)[:, None]
        scale = 1.0 / np.sqrt(np.maximum((weighted * jacobians).sum(axis=0) + np.diag(known), 1e-300))
        self._jacobians = jacobians * scale
        self._prior = known * scale * scale[:, None]
        self._pull = pull * scale
        self._scaled = -2.0 * float(np.log(scale).sum())
        self._ridge = 1e-12 * np.eye(len(scale))  # directions that no data determine carry no noise either

    def _compressed(self, jacobians: Array, residuals: Array, robot: Array) -> tuple[Array, Array, Array]:
        """Replace the many rows that the noise of the image alone makes by as many as there are unknowns, and a sum."""
        alone, size = robot == 0.0, jacobians.shape[1]
        seen = alone & jacobians.any(axis=1)  # of several cameras, few see a point
        if seen.sum() <= size:
            return jacobians, residuals, robot
        q, r = np.linalg.qr(jacobians[seen])
        within = q.T @ residuals[seen]
        self._beside = float((residuals[alone] ** 2).sum() - within @ within)
        self._unused -= int(alone.sum()) - size
        return (
            np.concatenate((r, jacobians[~alone])),
            np.concatenate((within, residuals[~alone])),
            np.concatenate((np.zeros(size), robot[~alone])),
        )

    @property
    def robot_matters(self) -> bool:
        """Whether there is any stated noise of the robot."""
        return bool(self._parts[1].max(initial=0.0) > 0.0)

    def deviance(self, logs: Array) -> float:
        """Return minus twice the logarithm of the likelihood of variance factors, up to a constant.

        Args:
            logs: Logarithms of the factors on the variances of image and robot, and of kinds of the arm's error if
                asked, shape (k,).
        """
        variances = (np.exp(logs)[:, None] * self._parts).sum(axis=0)
        information, pull = self._normal(variances)
        lower = np.linalg.cholesky(information)
        moved = np.linalg.solve(lower, pull)
        constant = float(np.log(variances).sum()) - self._unused * float(logs[0])
        quadratic = float((self._residuals**2 / variances).sum() - moved @ moved) + self._beside / np.exp(logs[0])
        return float(constant + self._scaled + 2.0 * np.log(np.diag(lower)).sum() + quadratic)

    def slope(self, logs: Array) -> tuple[Array, Array]:
        """Return the gradient of the deviance, shape (k,), and the expected second derivatives, shape (k, k)."""
        parts = np.exp(logs)[:, None] * self._parts
        variances = parts.sum(axis=0)
        information, pull = self._normal(variances)
        inverse = np.linalg.inv(information)
        left = self._residuals - self._jacobians @ (inverse @ pull)
        shares = parts / variances
        leverage = ((self._jacobians @ inverse) * self._jacobians).sum(axis=1) / variances
        gradient = (shares * (1.0 - leverage - left**2 / variances)).sum(axis=1)
        gradient[0] -= self._unused + self._beside / np.exp(logs[0])
        # of the information, the other parts and what they leave for the robot: no further product over all rows
        others = []
        for share in np.delete(shares, 1, axis=0):
            rows = self._jacobians if share.all() else self._jacobians[share > 0.0]
            others.append((rows.T * (share / variances)[share > 0.0]) @ rows)
        robot = information - self._prior - self._ridge - sum(others)
        taken = [inverse @ other for other in (others[0], robot, *others[1:])]
        expected = (shares * (1.0 - 2.0 * leverage)) @ shares.T
        expected += [[(one * other.T).sum() for other in taken] for one in taken]
        expected[0, 0] -= self._unused
        return gradient, expected

    def _normal(self, variances: Array) -> tuple[Array, Array]:
        weighted = self._jacobians / variances[:, None]
        information = weighted.T @ self._jacobians + self._prior + self._ridge
        return information, weighted.T @ self._residuals - self._pull

    def maximum(self, logs: Array, free: Mask) -> tuple[Array, float]:
        """Return the factors of greatest likelihood, with the factors not free left unchanged, and the deviance.

        Args:
            logs: Where to begin, shape (k,).
            free: Which to move, shape (k,).
        """
        return self._descend(logs, np.eye(len(logs))[free])

    def common(self, logs: Array) -> tuple[Array, float]:
        """As :meth:`maximum` with one factor on both."""
        return self._descend(logs, np.ones((1, 2)))

    def _descend(self, logs: Array, directions: Array) -> tuple[Array, float]:
        """Fisher scoring along some directions, shape (m, k)."""
        least = self.deviance(logs)
        for _ in range(_STEPS):
            gradient, expected = self.slope(logs)
            curvature = directions @ expected @ directions.T
            ridge = 1e-6 * max(1.0, float(np.trace(curvature))) * np.eye(len(directions))
            step = -np.linalg.solve(curvature + ridge, directions @ gradient) @ directions
            step = np.clip(step, -2.0, 2.0)
            for _ in range(_HALVINGS):
                candidate = np.clip(logs + step, -_LIMIT, _LIMIT)
                deviance = self.deviance(candidate)
                if deviance <= least:
                    break
                step = step / 2.0
            else:
                return logs, least
            gained, logs, least = least - deviance, candidate, deviance
            if gained < _CONVERGED:
                break
        return logs, least


def noise_factors(
    unknowns: Unknowns,
    problem: CalibrationProblem,
    layout: ParameterLayout,
    used: Mask,
    free: tuple[str, ...] = NOISE_SOURCES,
) -> NoiseFactors:
    """Compute factors on the stated noise of image and robot from the residuals of a fit.

    Those to go on with are, where the data tell both noises, these. A noise of which they only know a bound keeps its
    size if that is within the bound, and takes the bound if not. Where neither is known, both are taken to be larger by
    the same factor, which makes no difference to the cameras: noises that cannot be told apart have the same effect.

    Args:
        unknowns: The fit.
        problem: The observations.
        layout: Places of the unknowns.
        used: Which spots count, shape (c, n).
        free: Which of :data:`NOISE_SOURCES` may differ from what is stated.
    """
    *found, p_value, scale = _profiles(unknowns, problem, layout, used, free)
    image, robot, common = (each.factor() if isinstance(each, _Profile) else each for each in found)
    return NoiseFactors(image, robot, common, p_value, scale)


def noise_scale(
    unknowns: Unknowns, problem: CalibrationProblem, layout: ParameterLayout, used: Mask, free: tuple[str, ...]
) -> tuple[float, float]:
    """Compute the ``scale`` of :func:`noise_factors`, without the ends of intervals that do not matter for it."""
    return _profiles(unknowns, problem, layout, used, free)[-1]


@dataclass(frozen=True)
class _Profile:
    """Profile likelihood of the logarithm of a variance factor.

    Attributes:
        best: Of greatest likelihood.
        allowed: Deviance at the ends of the interval.
        deviance: Of a logarithm.
        brackets: Logarithms around the lower and the upper end; None: there is no such end.
    """

    best: float
    allowed: float
    deviance: Callable[[float], float]
    brackets: tuple[tuple[float, float] | None, tuple[float, float] | None]

    @property
    def determined(self) -> bool:
        """Whether the data bound the factor from both sides."""
        return None not in self.brackets

    def factor(self) -> Factor:
        """Compute the factor with the ends of its interval."""
        lower, upper = self.brackets
        ends = [-np.inf if lower is None else self._end(*lower), np.inf if upper is None else self._end(*upper)]
        value = self.best if abs(self.best) < 0.99 * _LIMIT else np.sign(self.best) * np.inf
        low, value, high = np.exp(np.array([ends[0], value, ends[1]]) / 2.0)
        return Factor(float(value), float(low), float(high))

    def _end(self, inner: float, outer: float) -> float:
        return float(scipy.optimize.brentq(lambda at: self.deviance(at) - self.allowed, inner, outer, xtol=1e-3))


_Profiles = tuple[_Profile | Factor, _Profile | Factor, _Profile | Factor, float, tuple[float, float]]


def _profiles(
    unknowns: Unknowns, problem: CalibrationProblem, layout: ParameterLayout, used: Mask, free: tuple[str, ...]
) -> _Profiles:
    """Return the parts of :func:`noise_factors`, with the ends of intervals still to be searched."""
    likelihood = NoiseLikelihood(unknowns, problem, layout, used)
    stated = likelihood.deviance(np.zeros(2))
    if not likelihood.robot_matters:
        free = tuple(source for source in free if source != "robot")
    if len(free) < len(NOISE_SOURCES):
        return _one_factor(likelihood, stated, np.array([source in free for source in NOISE_SOURCES]))
    same, same_deviance = likelihood.common(np.zeros(2))
    common = _profile(same[0], same_deviance, lambda at: likelihood.deviance(np.full(2, at)))
    starts = (same, same - _FAR * _IMAGE, same - _FAR * _ROBOT)
    best, least = min((likelihood.maximum(start, _BOTH) for start in starts), key=lambda found: found[1])

    def given(fixed: Mask, at: float) -> tuple[Array, float]:
        return likelihood.maximum(np.where(fixed, at, best), ~fixed)

    image = _profile(best[0], least, lambda at: given(_IMAGE, at)[1])
    robot = _profile(best[1], least, lambda at: given(_ROBOT, at)[1])
    logs = best
    if image.determined and not robot.determined:
        logs = given(_ROBOT, _nearest_bound(robot))[0]
    elif robot.determined and not image.determined:
        logs = given(_IMAGE, _nearest_bound(image))[0]
    elif not image.determined:
        logs = same if common.determined else np.zeros(2)
    return image, robot, common, _chance(stated - least, 2), _deviations(logs)


def _nearest_bound(profile: _Profile) -> float:
    """Return the logarithm of a variance factor within the bounds, as near to that of 1 as may be."""
    factor = profile.factor()
    return 2.0 * float(np.log(np.clip(1.0, factor.low, factor.high)))


def _one_factor(likelihood: NoiseLikelihood, stated: float, free: Mask) -> _Profiles:
    """As :func:`_profiles` where at most one of the noises is not as stated."""
    as_stated = Factor(1.0, 1.0, 1.0)
    if not free.any():
        return as_stated, as_stated, as_stated, 1.0, (1.0, 1.0)
    best, least = likelihood.maximum(np.zeros(2), free)
    factor = _profile(best[free][0], least, lambda at: likelihood.deviance(np.where(free, at, 0.0)))
    image, robot = (factor if each else as_stated for each in free)
    scale = _deviations(best if factor.determined else np.zeros(2))
    return image, robot, factor, _chance(stated - least, 1), scale


def _deviations(logs: Array) -> tuple[float, float]:
    """Return the factors on standard deviations, from logarithms of the factors on variances."""
    return float(np.exp(logs[0] / 2.0)), float(np.exp(logs[1] / 2.0))


def _chance(gained: float, parameters: int) -> float:
    """Return the probability of a given gain in deviance from unnecessary parameters."""
    return float(chi2_beyond(max(0.0, gained), parameters))


def _profile(best: float, least: float, deviance: Callable[[float], float]) -> _Profile:
    """Bracket the ends of an interval: the deviance there is larger by the quantile of chi-square.

    Args:
        best: Logarithm of the variance factor of greatest likelihood.
        least: Deviance there.
        deviance: Of a logarithm.
    """
    allowed = least + float(chi2_limit(1.0 - _CHANCE, 1))

    def bracket(side: float) -> tuple[float, float] | None:
        inner, stride = best, 0.1
        while abs(outer := inner + side * stride) <= _LIMIT:
            if deviance(outer) > allowed:
                return inner, outer
            inner, stride = outer, 2.0 * stride
        return None

    return _Profile(best, allowed, deviance, (bracket(-1.0), bracket(1.0)))
