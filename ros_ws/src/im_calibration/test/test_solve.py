"""The solver against independent references: finite differences, the full normal equations, scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from bench.calibration.synthetic import Design, make_scene
from im_calibration.estimation.residuals import image_residuals, linearise
from im_calibration.estimation.solve import maximise_likelihood, robust_fit
from im_calibration.estimation.start import start
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns, intrinsics_of

EVERYTHING = Design(poses=14, anisotropy=3.0, joint_offset_prior_sd=0.003, missing_share=0.1)


def true_unknowns(scene):
    cameras = scene.cameras
    return Unknowns(
        tuple(c.lens for c in cameras),
        intrinsics_of(cameras),
        np.array([c.R_cam_base for c in cameras]),
        np.array([c.t_cam_base for c in cameras]),
        scene.led_offset_error,
        scene.joint_offsets,
        np.random.default_rng(0).normal(0.0, 1e-3, scene.problem.positions.shape),
    )


def test_jacobian_by_finite_differences():
    scene = make_scene(EVERYTHING, 1)
    problem, layout, unknowns = scene.problem, ParameterLayout.of(scene.problem), true_unknowns(scene)
    used = problem.detected
    line = linearise(unknowns, problem, layout, used)
    assert layout.size == 14 * 2 + 3 + 6
    for i in range(layout.size):
        step = np.zeros(layout.size)
        step[i] = 1e-6
        ahead = image_residuals(unknowns.moved(step, layout, unknowns.displacements), problem, used)
        back = image_residuals(unknowns.moved(-step, layout, unknowns.displacements), problem, used)
        np.testing.assert_allclose(line.jacobians[..., i], (back - ahead) / 2e-6, rtol=1e-5, atol=2e-4)


def test_elimination_equals_the_full_normal_equations():
    scene = make_scene(EVERYTHING, 2)
    problem, layout = scene.problem, ParameterLayout.of(scene.problem)
    line = linearise(true_unknowns(scene), problem, layout, problem.detected)
    noise = np.zeros_like(line.covariances)
    for c in range(2):
        rows = slice(2 * c, 2 * c + 2)
        noise[:, rows, rows] = np.where(problem.detected[c][:, None, None], problem.spot_covariances[c], np.eye(2))
    weights, n, size = np.linalg.inv(noise), len(problem.positions), layout.size
    full = np.zeros((size + 3 * n, size + 3 * n))
    for i in range(n):
        both = np.zeros((4, size + 3 * n))
        both[:, :size] = line.jacobians[i]
        both[:, size + 3 * i : size + 3 * i + 3] = line.by_point[i]
        full += both.T @ weights[i] @ both
        block = slice(size + 3 * i, size + 3 * i + 3)
        full[block, block] += np.linalg.inv(problem.position_covariances[i])
    schur = full[:size, :size] - full[:size, size:] @ np.linalg.solve(full[size:, size:], full[size:, :size])
    reduced = np.einsum("nia,nij,njb->ab", line.jacobians, np.linalg.inv(line.covariances), line.jacobians)
    np.testing.assert_allclose(reduced, schur, rtol=1e-6, atol=1e-6 * np.abs(schur).max())


def test_noise_free_data_give_the_truth_back():
    scene = make_scene(Design(poses=25, sigma_px=1e-7, sigma_m=1e-10), 3)
    honest = replace(
        scene.problem,
        spot_covariances=np.tile(1e-4 * np.eye(2), (2, 25, 1, 1)),
        position_covariances=np.tile(1e-8 * np.eye(3), (25, 1, 1)),
    )
    layout = ParameterLayout.of(honest)
    first = robust_fit(start(honest, layout), honest, layout, honest.detected)
    fit = maximise_likelihood(first.unknowns, honest, layout, honest.detected)
    truth = true_unknowns(scene)
    np.testing.assert_allclose(fit.unknowns.intrinsics[:, :4], truth.intrinsics[:, :4], atol=2e-2)
    np.testing.assert_allclose(fit.unknowns.translations, truth.translations, atol=2e-4)
    np.testing.assert_allclose(fit.unknowns.led_offset, truth.led_offset, atol=1e-5)
    assert fit.chi2 - layout.prior(fit.unknowns).chi2 < 1e-2


def test_it_finds_the_maximum_that_scipy_finds_on_the_full_problem():
    scene = make_scene(Design(poses=14, anisotropy=3.0), 5)
    problem, layout = scene.problem, ParameterLayout.of(scene.problem)
    first = robust_fit(start(problem, layout), problem, layout, problem.detected)
    fit = maximise_likelihood(first.unknowns, problem, layout, problem.detected)
    n = len(problem.positions)
    image = np.linalg.cholesky(np.linalg.inv(problem.spot_covariances))
    position = np.linalg.cholesky(np.linalg.inv(problem.position_covariances))
    prior = np.sqrt(layout.prior_precision)
    scale = 1.0 / np.sqrt(np.diag(fit.information))

    def whitened(x):
        moved = fit.unknowns.displacements + 1e-4 * x[layout.size :].reshape(n, 3)
        unknowns = fit.unknowns.moved(scale * x[: layout.size], layout, moved)
        residuals = np.swapaxes(image_residuals(unknowns, problem, problem.detected).reshape(n, 2, 2), 0, 1)
        return np.concatenate(
            (
                np.einsum("cnji,cnj->cni", image, residuals).ravel(),
                np.einsum("nji,nj->ni", position, moved).ravel(),
                prior * unknowns.prior_vector(layout),
            )
        )

    here = np.zeros(layout.size + 3 * n)
    assert (whitened(here) ** 2).sum() == pytest.approx(fit.chi2, rel=1e-9)
    reference = least_squares(whitened, here + 0.3, method="lm", xtol=1e-12, ftol=1e-12)
    assert 2.0 * reference.cost == pytest.approx(fit.chi2, rel=1e-4)
    assert fit.chi2 <= 2.0 * reference.cost * (1.0 + 1e-9)


def test_one_gross_outlier_hardly_moves_the_robust_fit():
    scene = make_scene(Design(poses=30), 6)
    problem, layout = scene.problem, ParameterLayout.of(scene.problem)
    spots = problem.spots.copy()
    spots[0, 4] += [60.0, -30.0]
    spoiled = replace(problem, spots=spots)
    clean = robust_fit(start(problem, layout), problem, layout, problem.detected)
    fit = robust_fit(start(spoiled, layout), spoiled, layout, problem.detected)
    np.testing.assert_allclose(fit.unknowns.intrinsics[:, :2], clean.unknowns.intrinsics[:, :2], atol=2.0)
