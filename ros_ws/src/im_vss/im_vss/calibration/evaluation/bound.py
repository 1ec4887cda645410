"""The Cramer-Rao bound of a synthetic scene: what no unbiased calibrator can beat on its honest spots."""

import numpy as np

from im_vss.calibration.covariance import covariance_of
from im_vss.calibration.expected import ExpectedError, expected_error
from im_vss.calibration.residuals import linearise
from im_vss.calibration.synthetic import SyntheticScene
from im_vss.calibration.unknowns import Layout, Unknowns


def true_unknowns(scene: SyntheticScene) -> Unknowns:
    """The unknowns as they are, LED positions at those measured."""
    cameras, layout = scene.cameras, Layout.of(scene.problem)
    return Unknowns(
        np.array([[c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2], *c.D[:4]] for c in cameras]),
        np.array([c.R_cam_base for c in cameras]),
        np.array([c.t_cam_base for c in cameras]),
        scene.led_offset_error if layout.led else np.zeros(3),
        scene.joint_offsets[: layout.joints],
        np.zeros_like(scene.problem.positions),
    )


def cramer_rao(scene: SyntheticScene) -> ExpectedError:
    """Bound of both errors over the workspace, from the inliers at the truth, with the priors the data set states.

    Args:
        scene: A problem with its truth.
    """
    problem, layout, truth = scene.problem, Layout.of(scene.problem), true_unknowns(scene)
    line = linearise(truth, problem, layout, problem.detected & ~scene.outliers)
    information = np.einsum("nia,nij,njb->ab", line.jacobians, np.linalg.inv(line.covariances), line.jacobians)
    stated = np.diag(layout.prior_precision - layout.lens_precision)
    covariance = covariance_of(information + stated).matrix
    return expected_error(truth, covariance, problem.image_sizes, problem.workspace)
