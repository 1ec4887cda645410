"""Chi-squared distribution by ``scipy.special``, which loads with the first use: ``scipy.stats`` takes a second."""

from typing import Any

import scipy


def chi2_beyond(chi2: Any, dof: Any) -> Any:
    """Return the probability of a larger value.

    Args:
        chi2: The value.
        dof: Degrees of freedom.
    """
    return scipy.special.chdtrc(dof, chi2)


def chi2_limit(chance: float, dof: Any) -> Any:
    """Return the value exceeded with a probability.

    Args:
        chance: The probability.
        dof: Degrees of freedom.
    """
    return scipy.special.chdtri(dof, chance)


def chi2_median(dof: float) -> float:
    """Return the median for degrees of freedom."""
    return float(2.0 * scipy.special.gammaincinv(0.5 * dof, 0.5))
