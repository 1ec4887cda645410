"""Maximum-likelihood centre of a spot in a difference of two frames."""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from im_cell.psf import amplitude_to_flux, flux_to_amplitude, pixel_derivatives, pixel_integrals
from im_cell.sensor import SensorNoise

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

_WINDOW_SIGMAS = 4.5
_MINIMUM_HALF = 5
_ITERATIONS = 25
_TOLERANCE_PX = 1e-5
_SIGMA_RANGE = (0.3, 8.0)
_MAXIMUM_STEP_PX = 1.0
_LEAST_MARGIN = -1e3
_EVEN = [(x, order - x) for order in (2, 4, 6) for x in range(order + 1)]
"""Orders of the shapes along columns and rows that leave the centre where it is."""
_SQRT2PI = float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True)
class SpotFit:
    """A Gaussian spot fitted to a difference of two frames.

    Attributes:
        u: Column of the centre, OpenCV pixel centres [px].
        v: Row of the centre [px].
        covariance: Covariance of (u, v), shape (2, 2) [px^2].
        amplitude: Peak above the background [DN].
        sigma: Standard deviation of the spot [px].
        flux_snr: Flux over its standard deviation [-].
        chi2_per_dof: Mean squared normalised residual of the fit, but for what is alike on opposite sides [-].
        saturated: Number of saturated pixels in the spot.
        converged: Whether the fit came to rest inside its window.
    """

    u: float
    v: float
    covariance: Array
    amplitude: float
    sigma: float
    flux_snr: float
    chi2_per_dof: float
    saturated: int
    converged: bool


def fit_spot(on: Frame, off: Frame, start: tuple[float, float], sigma: float, noise: SensorNoise) -> SpotFit:
    """Fit a pixel-integrated Gaussian on a constant background to ``on - off`` around a start.

    Newton's method on (u, v, flux, sigma, background); each pixel is weighted by the variance the noise model predicts
    for the fitted spot on the mean of the off frame, so that the weights do not follow the noise of the data. A pixel
    that saturates only with the light says that it is at least that bright: the logarithm of the upper tail of its
    distribution takes the place of its squared residual. A disc, an ellipse or a smear is no Gaussian, but alike on
    opposite sides, so that its centre is that of the Gaussian: even shapelets count as no misfit.
    Sources: Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory", 3.9 (variance by the mean);
    J. Tobin, "Estimation of relationships for limited dependent variables", Econometrica 26, 1958 (censored data);
    A. Refregier, "Shapelets: I. A method for image analysis", MNRAS 338, 2003.

    Args:
        on: Frame with the light, shape (h, w) [DN].
        off: Frame without it, shape (h, w) [DN].
        start: Column and row near the centre [px].
        sigma: Guess of the spot's standard deviation [px].
        noise: Noise of the sensor that took the frames.

    Returns:
        The fit; `converged` is False where the data support none.
    """
    window = _Window(on, off, start, sigma, noise)
    first = window.start(sigma)
    theta, converged = _settle(window, first, whole=False)
    if window.censored.any():  # the rest of the spot starts them near enough: far away their likelihood misleads
        theta, converged = _settle(window, theta if converged else first, whole=True)
    return window.result(theta, converged)


def _settle(window: "_Window", theta: Array, whole: bool) -> tuple[Array, bool]:
    """The likeliest parameters near `theta`, and whether the search came to rest.

    Args:
        window: The pixels.
        theta: Where the search begins, shape (5,).
        whole: Whether to hear the saturated pixels too.
    """
    for _ in range(_ITERATIONS):
        step = window.step(theta, whole)
        if step is None:
            break
        shift = float(np.abs(step[:2]).max())
        if shift > _MAXIMUM_STEP_PX:
            step *= _MAXIMUM_STEP_PX / shift
        step[3] = np.clip(step[3], -0.5 * theta[3], theta[3])
        theta = theta + step
        if not window.holds(theta):
            break
        if shift < _TOLERANCE_PX:
            return theta, True
    return theta, False


class _Window:
    """Pixels around a candidate, and the linearised model on the pixels."""

    def __init__(self, on: Frame, off: Frame, start: tuple[float, float], sigma: float, noise: SensorNoise) -> None:
        half = max(_MINIMUM_HALF, int(np.ceil(_WINDOW_SIGMAS * sigma)))
        column, row = round(start[0]), round(start[1])
        self.rows = np.arange(max(row - half, 0), min(row + half + 1, on.shape[0]), dtype=float)
        self.columns = np.arange(max(column - half, 0), min(column + half + 1, on.shape[1]), dtype=float)
        area = np.s_[int(self.rows[0]) : int(self.rows[-1]) + 1, int(self.columns[0]) : int(self.columns[-1]) + 1]
        on_area, off_area = on[area].astype(float), off[area].astype(float)
        self.difference = on_area - off_area
        self.usable = off_area < noise.saturation
        self.censored = self.usable & (on_area >= noise.saturation)
        self.least = noise.saturation - 0.5 - off_area  # pixels that round to the largest value have at least this
        self.background = np.asarray(cv2.blur(off_area, (3, 3), borderType=cv2.BORDER_REPLICATE), dtype=float)
        self.off_variance = noise.variance(self.background)
        self.noise = noise

    def start(self, sigma: float) -> Array:
        """Start values: moments of the pixels above half of the brightest."""
        peak = float(self.difference.max())
        weights = np.where(self.difference > 0.5 * peak, self.difference, 0.0)
        total = max(float(weights.sum()), 1e-9)
        u = float((weights.sum(axis=0) * self.columns).sum() / total)
        v = float((weights.sum(axis=1) * self.rows).sum() / total)
        return np.array([u, v, amplitude_to_flux(peak, sigma), sigma, 0.0])

    def holds(self, theta: Array) -> bool:
        """Whether parameters are finite, inside the window and of a possible width."""
        return bool(
            np.all(np.isfinite(theta))
            and self.columns[0] <= theta[0] <= self.columns[-1]
            and self.rows[0] <= theta[1] <= self.rows[-1]
            and _SIGMA_RANGE[0] <= theta[3] <= _SIGMA_RANGE[1]
        )

    def step(self, theta: Array, whole: bool) -> Array | None:
        """Newton step from `theta`, None where the normal equations are singular."""
        residual, jacobian, weight, _ = self.linearised(theta, whole)
        try:
            return np.asarray(np.linalg.solve((jacobian.T * weight) @ jacobian, jacobian.T @ (weight * residual)))
        except np.linalg.LinAlgError:
            return None

    def linearised(self, theta: Array, whole: bool = True) -> tuple[Array, Array, Array, Array]:
        """Return residuals (n,) [DN], Jacobian (n, 5), weights (n,) [1/DN^2] and the shares of a full pixel (n,) [-].

        Of the usable pixels, without saturated ones unless `whole`. Residual and weight of a saturated one are those
        of the parabola that touches its log-likelihood at `theta`: with the margin z and the inverse Mills ratio m,
        sd / (m + z) and m (m + z) / sd^2.
        """
        u, v, flux, sigma, offset = theta
        along_u, along_v = pixel_integrals(u, sigma, self.columns), pixel_integrals(v, sigma, self.rows)
        du, du_dsigma = pixel_derivatives(u, sigma, self.columns)
        dv, dv_dsigma = pixel_derivatives(v, sigma, self.rows)
        shape = np.outer(along_v, along_u)
        signal = flux * shape
        variance = self.off_variance + self.noise.variance(self.background + np.maximum(signal + offset, 0.0))
        jacobian = np.stack(
            (
                flux * np.outer(along_v, du),
                flux * np.outer(dv, along_u),
                shape,
                flux * (np.outer(dv_dsigma, along_u) + np.outer(along_v, du_dsigma)),
                np.ones_like(shape),
            ),
            axis=-1,
        )
        deviation = np.sqrt(variance)
        margin = np.maximum((signal + offset - self.least) / deviation, _LEAST_MARGIN)
        mills = np.exp(-0.5 * margin**2 - scipy.special.log_ndtr(margin)) / _SQRT2PI
        share = np.where(self.censored, mills * (mills + margin), 1.0)
        residual = np.where(self.censored, deviation / (mills + margin), self.difference - signal - offset)
        mask = self.usable if whole else self.usable & ~self.censored
        return residual[mask], jacobian[mask], (share / variance)[mask], share[mask]

    def even_shapes(self, u: float, v: float, sigma: float) -> Array:
        """Return shapelets of even orders on the usable pixels, shape (n, 15)."""
        along_u, along_v = (
            np.polynomial.hermite.hermvander(away, 6) * np.exp(-0.5 * away**2)[:, None]
            for away in ((self.columns - u) / sigma, (self.rows - v) / sigma)
        )
        return np.stack([np.outer(along_v[:, j], along_u[:, i])[self.usable] for i, j in _EVEN], axis=1)

    def result(self, theta: Array, converged: bool) -> SpotFit:
        """The fit at `theta`."""
        u, v, flux, sigma = (float(value) for value in theta[:4])
        covariance, snr, chi2 = np.full((2, 2), np.inf), 0.0, np.inf
        residual, jacobian, weight, share = self.linearised(theta)
        degrees = float(share.sum()) - len(theta) - len(_EVEN)
        if converged and degrees > 0.0:
            full = np.linalg.inv((jacobian.T * weight) @ jacobian)
            covariance = full[:2, :2]
            snr = flux / float(np.sqrt(full[2, 2]))
            root = np.sqrt(weight)
            shapes = root[:, None] * np.column_stack((jacobian, self.even_shapes(u, v, sigma)))
            left = root * residual - shapes @ np.linalg.lstsq(shapes, root * residual, rcond=None)[0]
            chi2 = float(left @ left) / degrees
        near = np.hypot(self.columns[None, :] - u, self.rows[:, None] - v) <= 3.0 * max(sigma, 1.0)
        return SpotFit(
            u=u,
            v=v,
            covariance=covariance,
            amplitude=flux_to_amplitude(flux, sigma),
            sigma=sigma,
            flux_snr=snr,
            chi2_per_dof=chi2,
            saturated=int(((self.censored | ~self.usable) & near).sum()),
            converged=converged and degrees > 0.0,
        )
