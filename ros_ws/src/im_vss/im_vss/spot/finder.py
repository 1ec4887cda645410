"""Decision whether a pair of frames shows the light, where, and if not, why."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from im_cell.sensor import SensorNoise
from im_core.config import Model
from im_core.errors import DataError
from im_vss.spot.fit import SpotFit, fit_spot

Frame = NDArray[np.uint8]

_REACH_SIGMAS = 4.0
_MOST_PEAKS = 6
_MOST_CANDIDATES = 3
_ERASE_SIGMAS = 5.0
_ERASE_MINIMUM_PX = 8.0
_NEAR_PX = 16
_NOISIER = 1.1
_CUT, _CUT_VARIANCE = 3.0, 0.9733  # of a unit normal distribution that is cut off there
_SCALE_ROUNDS, _FEWEST_STEPS = 8, 200


@dataclass(frozen=True)
class Peak:
    """A local maximum of the matched filter.

    Attributes:
        u: Column [px].
        v: Row [px].
        snr: Response over the standard deviation that noise alone gives [-].
    """

    u: int
    v: int
    snr: float


@dataclass(frozen=True)
class SearchDisc:
    """A disc in which the light must be: centre and radius [px]."""

    u: float
    v: float
    radius: float


class MatchedFilter:
    """Signal-to-noise ratio of a Gaussian spot at every pixel of a difference of two frames, or of a disc in them.

    Source: North's matched filter for white noise, after dividing each pixel by its standard deviation.

    Attributes:
        noise: Noise of the sensor; with more read noise than given, where the frames have more.
    """

    def __init__(
        self, on: Frame, off: Frame, sigma: float, noise: SensorNoise, region: SearchDisc | None = None
    ) -> None:
        """Filter ``on - off``, shape (h, w) [DN], for spots of standard deviation `sigma` [px], within a region."""
        kernel = _kernel(sigma)
        rows, columns = _window(on.shape, len(kernel) // 2 + 1, region)
        on, off = on[rows, columns], off[rows, columns]
        self._corner = columns.start, rows.start
        deviations = np.sqrt(2.0 * noise.variance(np.arange(256, dtype=np.float32)))  # of all values of a background
        deviation = cv2.LUT(cv2.blur(off, (3, 3)), deviations)
        whitened = np.asarray(cv2.subtract(on, off, dtype=cv2.CV_32F) / deviation, dtype=np.float32)
        self.noise = noise
        if (scale := _scale(whitened)) > _NOISIER:
            excess = (scale**2 - 1.0) * float((deviation**2).mean()) / 2.0 * noise.gain**2
            self.noise = noise.model_copy(update={"read_noise": float(np.hypot(noise.read_noise, np.sqrt(excess)))})
            whitened /= scale
        self._response = np.asarray(
            cv2.sepFilter2D(whitened, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT), dtype=np.float32
        )
        self._signed = self._response.copy()
        if region is not None:
            outside = np.full(self._response.shape, 255, np.uint8)
            self._draw(outside, region.u, region.v, region.radius, 0)
            self._response[outside > 0] = -np.inf

    def strongest(self) -> Peak:
        """Return the strongest remaining peak."""
        _, snr, _, (u, v) = cv2.minMaxLoc(self._response)
        return Peak(u=u + self._corner[0], v=v + self._corner[1], snr=snr)

    def darkening(self, u: float, v: float) -> float:
        """Return the strongest response around (u, v) [px] to light that went out."""
        column, row = round(u) - self._corner[0], round(v) - self._corner[1]
        rows, columns = (slice(max(at - _NEAR_PX, 0), at + _NEAR_PX + 1) for at in (row, column))
        return -float(self._signed[rows, columns].min())

    def erase(self, u: float, v: float, radius: float) -> None:
        """Take a disc of `radius` [px] around (u, v) [px] out of the search."""
        self._draw(self._response, u, v, radius, -np.inf)

    def _draw(self, image: NDArray[Any], u: float, v: float, radius: float, value: float) -> None:
        place = round(u) - self._corner[0], round(v) - self._corner[1]
        cv2.circle(image, place, int(np.ceil(radius)), value, thickness=-1)


@cache
def _kernel(sigma: float) -> NDArray[np.float32]:
    """Return the filter of a spot along rows or columns, of unit energy."""
    reach = int(np.ceil(_REACH_SIGMAS * sigma))
    gaussian = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F), dtype=np.float32)
    return np.asarray(gaussian / np.sqrt((gaussian**2).sum()))


def _scale(whitened: NDArray[np.float32]) -> float:
    """Return the noise of a difference over the given one, by neighbours: they share light, and differ by noise."""
    steps = ((whitened[:, 1:] - whitened[:, :-1]) / np.sqrt(2.0)).ravel()[::3]
    scale = 1.0
    for _ in range(_SCALE_ROUNDS):
        kept = steps[np.abs(steps) < _CUT * scale]
        if len(kept) < _FEWEST_STEPS:
            return 1.0
        scale = float(np.sqrt((kept**2).mean() / _CUT_VARIANCE))
    return scale


def _window(shape: tuple[int, ...], margin: int, region: SearchDisc | None) -> tuple[slice, slice]:
    """Return rows and columns that the filter needs for a region; all, where that is nowhere in the frame."""
    whole = slice(0, shape[0]), slice(0, shape[1])
    if region is None:
        return whole
    reach = int(np.ceil(region.radius)) + margin
    rows, columns = (
        slice(max(round(middle) - reach, 0), min(round(middle) + reach + 1, size))
        for middle, size in zip((region.v, region.u), shape, strict=True)
    )
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else whole


class SpotGates(Model):
    """Limits of a spot.

    Attributes:
        sigma_expected: Width the search is tuned to [px].
        sigma_low: Smallest width of a spot [px].
        sigma_high: Largest width of a spot [px].
        detection_snr: Smallest response of the matched filter [-]. Noise alone reaches about 5 in a 640 x 480 frame.
        faint_snr: From here on a response below `detection_snr` is called "too faint" rather than "nothing" [-].
        chi2_per_dof: Largest misfit of the Gaussian [-].
        saturated_pixels: Most saturated pixels with which a centre is still given.
        rival_ratio: A second candidate this bright, relative to the first, makes the result ambiguous [-].
        edge: Nearest a centre may be to the edge of the image [px].
    """

    sigma_expected: float = Field(gt=0.0)
    sigma_low: float = Field(gt=0.0)
    sigma_high: float = Field(gt=0.0)
    detection_snr: float = Field(ge=6.0)
    faint_snr: float = Field(ge=5.0)
    chi2_per_dof: float = Field(gt=1.0)
    saturated_pixels: int = Field(ge=0)
    rival_ratio: float = Field(gt=0.0, le=1.0)
    edge: float = Field(ge=0.0)


@dataclass(frozen=True)
class SpotFinding:
    """Result of :func:`find_spot`.

    Attributes:
        spot: The spot, None when it was not found.
        cause: Why it was not found, one clause; empty when it was.
        snr: Strongest response of the matched filter [-].
        candidates: Up to three spots that passed every gate, brightest first.
        refused: What looked like a spot and was none, and why.
        region: Where the light was searched; None: everywhere.
    """

    spot: SpotFit | None
    cause: str
    snr: float
    candidates: tuple[SpotFit, ...] = ()
    refused: tuple[str, ...] = ()
    region: SearchDisc | None = None


def find_spot(
    on: Frame, off: Frame, noise: SensorNoise, gates: SpotGates, region: SearchDisc | None = None
) -> SpotFinding:
    """Find the light in the difference of two frames of the same scene.

    Args:
        on: Frame with the light, shape (h, w) [DN].
        off: Frame without it, shape (h, w) [DN].
        noise: Noise of the sensor that took the frames; if they show more, that counts.
        gates: What the spot must be like.
        region: Where it must be, if that is known.

    Returns:
        The spot with its covariance, or the cause why there is none.

    Raises:
        DataError: The frames differ in shape.
    """
    if on.shape != off.shape:
        raise DataError(f"The frames of a pair have shapes {on.shape} and {off.shape}, they must be the same.")
    response = MatchedFilter(on, off, gates.sigma_expected, noise, region)
    first = peak = response.strongest()
    accepted: list[SpotFit] = []
    refusals: list[str] = []
    for _ in range(_MOST_PEAKS):
        if peak.snr < gates.detection_snr:
            break
        fit = fit_spot(on, off, (peak.u, peak.v), gates.sigma_expected, response.noise)
        refusal = _refusal(fit, on.shape, gates)
        if not refusal and response.darkening(peak.u, peak.v) > max(gates.faint_snr, gates.rival_ratio * peak.snr):
            refusal = "the camera moved: light went out beside it"
        if refusal:
            refusals.append(f"{refusal} at ({peak.u}, {peak.v}) px")
        else:
            accepted.append(fit)
        response.erase(peak.u, peak.v, max(_ERASE_MINIMUM_PX, _ERASE_SIGMAS * min(fit.sigma, gates.sigma_high)))
        peak = response.strongest()
    accepted.sort(key=lambda fit: -fit.amplitude * fit.sigma**2)
    finding = _decide(tuple(accepted), refusals, max(first.snr, 0.0), gates)
    cause = finding.cause
    if region is not None and finding.spot is None and not finding.candidates:
        cause += f"; searched within {region.radius:g} px of ({region.u:.0f}, {region.v:.0f}) px"
    return replace(
        finding, cause=cause, candidates=finding.candidates[:_MOST_CANDIDATES], refused=tuple(refusals), region=region
    )


def _refusal(fit: SpotFit, shape: tuple[int, ...], gates: SpotGates) -> str:
    """Return the reason against a candidate, empty for a spot."""
    if fit.saturated > gates.saturated_pixels:
        return f"saturated: {fit.saturated} pixels, at most {gates.saturated_pixels} are allowed"
    if not fit.converged:
        return "wrong shape: no Gaussian fits"
    if not gates.sigma_low <= fit.sigma <= gates.sigma_high:
        return f"wrong size: sigma {fit.sigma:.2f} px is not between {gates.sigma_low:g} and {gates.sigma_high:g}"
    if fit.chi2_per_dof > gates.chi2_per_dof:
        return f"wrong shape: chi2/dof {fit.chi2_per_dof:.1f} is more than {gates.chi2_per_dof:g}"
    if fit.flux_snr < gates.faint_snr:
        return f"too faint: SNR {fit.flux_snr:.1f} is less than {gates.faint_snr:g}"
    high_v, high_u = shape[0] - 1 - gates.edge, shape[1] - 1 - gates.edge
    if not (gates.edge <= fit.u <= high_u and gates.edge <= fit.v <= high_v):
        return f"at the edge of the image: nearer than {gates.edge:g} px"
    return ""


def _decide(accepted: tuple[SpotFit, ...], refusals: list[str], snr: float, gates: SpotGates) -> SpotFinding:
    """Choose among the candidates."""
    if accepted:
        brightness = [fit.amplitude * fit.sigma**2 for fit in accepted]
        rivals = [fit for fit, b in zip(accepted, brightness, strict=True) if b >= gates.rival_ratio * brightness[0]]
        if len(rivals) == 1:
            return SpotFinding(rivals[0], "", snr, accepted)
        places = ", ".join(f"({fit.u:.1f}, {fit.v:.1f})" for fit in rivals)
        return SpotFinding(None, f"several candidates: {places} px", snr, accepted)
    if refusals:
        return SpotFinding(None, refusals[0], snr)
    if snr >= gates.faint_snr:
        return SpotFinding(None, f"too faint: SNR {snr:.1f} is less than {gates.detection_snr:g}", snr)
    return SpotFinding(None, "no light seen: it is off, blocked or out of view", snr)
