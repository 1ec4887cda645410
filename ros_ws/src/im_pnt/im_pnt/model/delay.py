"""Times of transitions: constant, exponential, or any distribution of the standard library.

Analysis of timed nets is exact for exponential times (generalised stochastic Petri nets, Ajmone Marsan et al., 1984);
simulation takes them all.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from random import Random
from typing import NamedTuple

from im_core.errors import nearest
from im_pnt.errors import NetError


class _Kind(NamedTuple):
    parameters: tuple[str, ...]
    mean: Callable[..., float]
    sample: Callable[..., float]


_KINDS: Mapping[str, _Kind] = {
    "constant": _Kind(("value",), lambda value: value, lambda dice, value: value),
    "exponential": _Kind(("rate",), lambda rate: 1.0 / rate, lambda dice, rate: dice.expovariate(rate)),
    "uniform": _Kind(
        ("low", "high"), lambda low, high: (low + high) / 2.0, lambda dice, low, high: dice.uniform(low, high)
    ),
    "triangular": _Kind(
        ("low", "high", "mode"),
        lambda low, high, mode: (low + high + mode) / 3.0,
        lambda dice, low, high, mode: dice.triangular(low, high, mode),
    ),
    "gamma": _Kind(
        ("shape", "scale"),
        lambda shape, scale: shape * scale,
        lambda dice, shape, scale: dice.gammavariate(shape, scale),
    ),
    "weibull": _Kind(
        ("scale", "shape"),
        lambda scale, shape: scale * math.gamma(1.0 + 1.0 / shape),
        lambda dice, scale, shape: dice.weibullvariate(scale, shape),
    ),
    "lognormal": _Kind(
        ("mu", "sigma"),
        lambda mu, sigma: math.exp(mu + sigma * sigma / 2.0),
        lambda dice, mu, sigma: dice.lognormvariate(mu, sigma),
    ),
}
KINDS = tuple(_KINDS)
"""Names of the distributions."""


@dataclass(frozen=True, slots=True)
class Delay:
    """A distribution of times.

    Attributes:
        kind: One of :data:`KINDS`.
        values: Its parameters in order: constant (value), exponential (rate), uniform (low, high), triangular (low,
            high, mode), gamma (shape, scale), weibull (scale, shape), lognormal (mu, sigma) [s, 1/s].

    Raises:
        NetError: No such distribution, or parameters that it cannot have.
    """

    kind: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise NetError(f"there is no distribution '{self.kind}'{nearest(self.kind, KINDS)}")
        names = _KINDS[self.kind].parameters
        if len(self.values) != len(names):
            raise NetError(f"distribution {self.kind} has the parameters {', '.join(names)}; {self.values} were given")
        for name, value in zip(names, self.values, strict=True):
            lowest_allowed = value >= 0.0 if name in ("value", "low", "mode", "sigma") else value > 0.0
            if not math.isfinite(value) or not (lowest_allowed or name == "mu"):
                raise NetError(f"parameter {name} of distribution {self.kind} cannot be {value}")
        if "high" in names and self.values[1] < self.values[0]:
            raise NetError(f"distribution {self.kind}: high {self.values[1]} is less than low {self.values[0]}")
        if "mode" in names and not self.values[0] <= self.values[2] <= self.values[1]:
            raise NetError(f"mode {self.values[2]} of distribution {self.kind} is not between low and high")
        try:
            finite = math.isfinite(self.mean)
        except OverflowError:
            finite = False
        if not finite:
            raise NetError(f"distribution {self} has no finite mean")

    @property
    def mean(self) -> float:
        """Expected time [s]."""
        return _KINDS[self.kind].mean(*self.values)

    def sample(self, dice: Random) -> float:
        """Draw a time [s]."""
        return _KINDS[self.kind].sample(dice, *self.values)

    def parameters(self) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(_KINDS[self.kind].parameters, self.values, strict=True))

    def __str__(self) -> str:
        return f"{self.kind}({', '.join(f'{name} {value:g}' for name, value in self.parameters().items())})"


def exponential(rate: float) -> Delay:
    """Make an exponential distribution.

    Args:
        rate: Its rate [1/s].
    """
    return Delay("exponential", (rate,))
