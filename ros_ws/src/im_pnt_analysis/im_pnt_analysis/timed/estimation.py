"""Delays and probabilities estimated from measurements, with 95 % intervals.

Distributions are fitted by maximum likelihood and chosen by the Bayesian information criterion (Schwarz, 1978).
Intervals of their parameters are those of the profile likelihood; as samples are small, its bound is the squared
quantile of Student's t instead of that of chi-square. Intervals of probabilities are those of Clopper and Pearson
(1934), which hold the true one at least as often as they say.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_pnt.model.delay import Delay

Array = NDArray[np.float64]

LEVEL = 0.95
"""Share of intervals that hold the true value."""
_CONSTANT = 0.01
"""Coefficient of variation below which times are taken for constant."""
_FEW = 5
"""With fewer times no distribution is told from another, and intervals say nothing."""
_WIDEST = 1e4


@dataclass(frozen=True, slots=True)
class Interval:
    """From where to where a value may be, at :data:`LEVEL`."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class DelayEstimate:
    """How long a transition takes.

    Attributes:
        delay: The distribution; None: it takes no time.
        intervals: Of its parameters, by name; empty with too few times, or none that differ.
        count: Number of times.
        mean: Their mean [s].
    """

    delay: Delay | None
    intervals: Mapping[str, Interval]
    count: int
    mean: float


def estimate_share(hits: int, count: int) -> Interval:
    """Return the probability of an outcome with `hits` of `count` cases."""
    from scipy.stats import beta

    tail = (1.0 - LEVEL) / 2.0
    low = float(beta.ppf(tail, hits, count - hits + 1)) if hits else 0.0
    return Interval(low, float(beta.ppf(1.0 - tail, hits + 1, count - hits)) if hits < count else 1.0)


def estimate_delay(times: Sequence[float], kinds: Sequence[str] = ()) -> DelayEstimate:
    """The distribution of measured times.

    Constant where they hardly differ; else exponential, gamma, lognormal or Weibull. Where some are 0, which none of
    the latter can be, or where they are few, it is the gamma distribution of their mean and variance.

    Args:
        times: At least one, none negative [s].
        kinds: Distributions to choose from where the times differ; none: all that can be fitted.
    """
    sample = np.array(times, dtype=float)
    count, mean = len(sample), float(sample.mean())
    if mean <= 0.0:
        return DelayEstimate(None, {}, count, 0.0)
    variance = float(sample.var(ddof=1)) if count > 1 else 0.0
    if variance <= (_CONSTANT * mean) ** 2:
        return DelayEstimate(Delay("constant", (mean,)), {}, count, mean)
    if count < _FEW or sample.min() <= 0.0:
        return DelayEstimate(Delay("gamma", (mean * mean / variance, variance / mean)), {}, count, mean)
    kind = min(kinds or _FAMILIES, key=lambda name: _criterion(_FAMILIES[name], sample))
    family = _FAMILIES[kind]
    delay = Delay(kind, tuple(float(value) for value in family.fit(sample)))
    return DelayEstimate(delay, _intervals(family, delay, sample), count, mean)


@dataclass(frozen=True, slots=True)
class _Family:
    """A family of distributions.

    Attributes:
        fit: The parameters of the greatest likelihood.
        scipy: Name of the distribution in scipy.stats, its shapes, and its scale, from parameters.
        profile: The parameters of the greatest likelihood with one of them, by its number, at a value.
        positive: Whether each parameter is above 0, so that intervals are searched by factors.
    """

    fit: Callable[[Array], tuple[float, ...]]
    scipy: Callable[[tuple[float, ...]], tuple[str, tuple[float, ...], float]]
    profile: Callable[[Array, int, float], tuple[float, ...]]
    positive: tuple[bool, ...]

    def log_likelihood(self, sample: Array, values: tuple[float, ...]) -> float:
        """Return the logarithm of the likelihood of parameters."""
        from scipy import stats

        name, shapes, scale = self.scipy(values)
        return float(getattr(stats, name).logpdf(sample, *shapes, scale=scale).sum())


def _criterion(family: _Family, sample: Array) -> float:
    values = family.fit(sample)
    return len(values) * math.log(len(sample)) - 2.0 * family.log_likelihood(sample, values)


def _intervals(family: _Family, delay: Delay, sample: Array) -> dict[str, Interval]:
    from scipy.stats import t

    best = family.log_likelihood(sample, delay.values)
    bound = best - 0.5 * float(t.ppf(0.5 + LEVEL / 2.0, len(sample) - 1)) ** 2
    found = {}
    for number, (name, value) in enumerate(delay.parameters().items()):
        step = 1.0 if family.positive[number] else float(np.log(sample).std())

        def height(way: float, number: int = number, value: float = value, step: float = step) -> float:
            at = value * math.exp(way) if family.positive[number] else value + way * step
            return family.log_likelihood(sample, family.profile(sample, number, at)) - bound

        ends = (_crossing(height, -1.0), _crossing(height, 1.0))
        low, high = (value * math.exp(e) if family.positive[number] else value + e * step for e in ends)
        found[name] = Interval(low, high)
    return found


def _crossing(height: Callable[[float], float], side: float) -> float:
    """Return the zero on one side of a falling function positive at 0."""
    from scipy.optimize import brentq

    reach = 0.25
    while height(side * reach) > 0.0:
        reach *= 2.0
        if reach > math.log(_WIDEST):
            return side * reach
    return float(brentq(height, 0.0, side * reach, xtol=1e-4))


def _newton(function: Callable[[float], float], guess: float) -> float:
    """Where a monotonic function of a positive number is 0."""
    from scipy.optimize import brentq

    low, high = guess / 2.0, guess * 2.0
    while function(low) * function(high) > 0.0 and high < guess * _WIDEST:
        low, high = low / 2.0, high * 2.0
    return float(brentq(function, low, high, rtol=1e-10)) if function(low) * function(high) <= 0.0 else guess


def _gamma_shape(sample: Array, scale: float | None) -> float:
    """The best shape, with the best scale or a given one."""
    from scipy.special import digamma

    mean, logs = float(sample.mean()), float(np.log(sample).mean())
    gap = math.log(mean) - logs
    guess = (3.0 - gap + math.sqrt((gap - 3.0) ** 2 + 24.0 * gap)) / (12.0 * gap)
    if scale is None:
        return _newton(lambda shape: math.log(shape) - float(digamma(shape)) - gap, guess)
    return _newton(lambda shape: logs - math.log(scale) - float(digamma(shape)), mean / scale)


def _fit_gamma(sample: Array) -> tuple[float, ...]:
    shape = _gamma_shape(sample, None)
    return shape, float(sample.mean()) / shape


def _profile_gamma(sample: Array, number: int, value: float) -> tuple[float, ...]:
    return (value, float(sample.mean()) / value) if number == 0 else (_gamma_shape(sample, value), value)


def _profile_lognormal(sample: Array, number: int, value: float) -> tuple[float, ...]:
    logs = np.log(sample)
    return (value, math.sqrt(float(((logs - value) ** 2).mean()))) if number == 0 else (float(logs.mean()), value)


def _weibull_shape(sample: Array, scale: float | None) -> float:
    logs = np.log(sample if scale is None else sample / scale)
    logs = logs - logs.max() if scale is None else logs

    def slope(shape: float) -> float:
        powers = np.exp(np.minimum(shape * logs, 500.0))
        weighted = (powers * logs).sum() / powers.sum() if scale is None else (powers * logs).mean()
        return 1.0 / shape + float(logs.mean() - weighted)

    return _newton(slope, 1.2 / float(logs.std()))


def _weibull_scale(sample: Array, shape: float) -> float:
    most = float(sample.max())
    return most * math.pow(float(np.mean((sample / most) ** shape)), 1.0 / shape)


def _fit_weibull(sample: Array) -> tuple[float, ...]:
    shape = _weibull_shape(sample, None)
    return _weibull_scale(sample, shape), shape


def _profile_weibull(sample: Array, number: int, value: float) -> tuple[float, ...]:
    return (value, _weibull_shape(sample, value)) if number == 0 else (_weibull_scale(sample, value), value)


_FAMILIES: Mapping[str, _Family] = {
    "exponential": _Family(
        lambda sample: (1.0 / float(sample.mean()),),
        lambda values: ("expon", (), 1.0 / values[0]),
        lambda sample, _, value: (value,),
        (True,),
    ),
    "gamma": _Family(_fit_gamma, lambda values: ("gamma", (values[0],), values[1]), _profile_gamma, (True, True)),
    "lognormal": _Family(
        lambda sample: (float(np.log(sample).mean()), float(np.log(sample).std())),
        lambda values: ("lognorm", (values[1],), math.exp(values[0])),
        _profile_lognormal,
        (False, True),
    ),
    "weibull": _Family(
        _fit_weibull, lambda values: ("weibull_min", (values[1],), values[0]), _profile_weibull, (True, True)
    ),
}
