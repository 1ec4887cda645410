"""Curvature of the parameters of a camera: second order, which a covariance leaves out.

Source: D. M. Bates, D. G. Watts, "Nonlinear regression analysis and its applications" (1988), chapter 7.
"""

import numpy as np
from numpy.typing import NDArray

from im_calibration.estimation.projection import project
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns

Array = NDArray[np.float64]


def parameter_curvature(
    unknowns: Unknowns, layout: ParameterLayout, c: int, covariance: Array, positions: Array, weights: Array
) -> float:
    """Measure the bend of a camera's parameters within the covariance.

    A deviation along two directions moves the pixels by a second order; the parameters make up for that. The measure is
    the RMS length of this answer, over normal deviations of the covariance.

    Args:
        unknowns: The estimate.
        layout: Places of the unknowns.
        c: Number of the camera.
        covariance: Covariance of the parameters of the camera, shape (k, k).
        positions: Places of the points that it saw, shape (n, 3) [m].
        weights: Inverse covariances of their pixels, shape (n, 2, 2) [px^-2].

    Returns:
        Length in standard deviations; much below 1 for an ellipsoid.
    """
    values, vectors = np.linalg.eigh(covariance)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))
    place = layout.camera_slice(c)

    def slopes(step: Array) -> Array:
        whole = np.zeros(layout.size)
        whole[place] = step
        moved = unknowns.moved(whole, layout, unknowns.displacements)
        return np.asarray(project(moved, positions)[2][c] @ scaled)

    with np.errstate(all="ignore"):  # a camera that is hardly known may turn away from what it saw
        weighted = np.einsum("npa,npq->anq", slopes(np.zeros(len(scaled))), weights)
        bends = np.stack([(slopes(axis) - slopes(-axis)) / 2.0 for axis in scaled.T], axis=-1)
        answers = np.tensordot(weighted, bends, axes=((1, 2), (0, 1)))
        mean = np.einsum("aii->a", answers)
        rms = float(np.sqrt((2.0 * (answers**2).sum() + (mean**2).sum()) / 4.0))
    return rms if np.isfinite(rms) else float("inf")
