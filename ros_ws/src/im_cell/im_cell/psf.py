"""Image of a small light: a Gaussian integrated over square pixels."""

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SQRT2 = float(np.sqrt(2.0))
_SQRT2PI = float(np.sqrt(2.0 * np.pi))


def pixel_integrals(centre: float, sigma: float, pixels: Array) -> Array:
    """Compute the share of a unit Gaussian line on each pixel.

    Args:
        centre: Centre of the Gaussian [px].
        sigma: Its standard deviation [px].
        pixels: Pixel centres, shape (n,) [px].

    Returns:
        Shares, shape (n,) [-].
    """
    edges = (pixels - centre) / (_SQRT2 * sigma)
    half = 0.5 / (_SQRT2 * sigma)
    return np.asarray(0.5 * (scipy.special.erf(edges + half) - scipy.special.erf(edges - half)))


def pixel_derivatives(centre: float, sigma: float, pixels: Array) -> tuple[Array, Array]:
    """Compute derivatives of :func:`pixel_integrals` by the centre and by sigma, each of shape (n,) [1/px]."""
    upper = (pixels - centre + 0.5) / sigma
    lower = (pixels - centre - 0.5) / sigma
    g_upper = np.exp(-0.5 * upper**2) / (_SQRT2PI * sigma)
    g_lower = np.exp(-0.5 * lower**2) / (_SQRT2PI * sigma)
    return g_lower - g_upper, lower * g_lower - upper * g_upper


def amplitude_to_flux(amplitude: float, sigma: float) -> float:
    """Flux [DN] of a spot with a peak of `amplitude` [DN] and width `sigma` [px]."""
    return amplitude * 2.0 * np.pi * sigma**2


def flux_to_amplitude(flux: float, sigma: float) -> float:
    """Peak [DN] of a spot with `flux` [DN] and width `sigma` [px]."""
    return flux / (2.0 * np.pi * sigma**2)
