"""Errors of calibrated cameras, measured against true ones."""

import numpy as np
import pytest

from im_cell.calibration_error import evaluate, triangulate
from im_cell.camera_model import CameraModel
from im_cell.workspace import Workspace
from im_core.errors import DataError


def camera(x, focal=600.0):
    """A camera 4 m up at x, looking straight down."""
    rotation = np.diag([1.0, -1.0, -1.0])
    K = np.array([[focal, 0.0, 319.5], [0.0, focal, 239.5], [0.0, 0.0, 1.0]])
    D = np.array([-0.2, 0.04, 1e-3, -1e-3, 0.0])
    return CameraModel(640, 480, K, D, rotation, -rotation @ np.array([x, 0.0, 4.0]))


POINTS = Workspace((-1.0, -0.5, 0.6), (1.0, 0.5, 1.6)).grid((4, 3, 3))


def test_true_cameras_have_no_error():
    pair = [camera(-0.5), camera(0.5)]
    found = evaluate(pair, pair, POINTS)
    assert found.reprojection_rms_px == 0.0
    assert found.triangulation_rms_mm < 1e-6


def test_a_shift_of_both_cameras_shifts_every_point():
    true = [camera(-0.5), camera(0.5)]
    shifted = [camera(-0.497), camera(0.503)]
    found = evaluate(shifted, true, POINTS)
    np.testing.assert_allclose(found.triangulation_mm, 3.0, rtol=1e-6)


def test_reprojection_is_the_length_over_the_cameras_that_see_the_point():
    point = np.array([[0.0, 0.0, 1.0]])
    found = evaluate([camera(0.003)], [camera(0.0)], point)
    assert found.reprojection_px[0] == pytest.approx(0.6, rel=1e-3)  # 600 px * 3 mm / 3 m
    assert np.isnan(found.triangulation_mm[0])


def test_points_out_of_sight_do_not_count():
    pair = [camera(-0.5), camera(0.5)]
    found = evaluate(pair, pair, np.array([[9.0, 0.0, 1.0]]))
    assert np.isnan(found.reprojection_rms_px)
    assert np.isnan(found.triangulation_rms_mm)


def test_triangulation_inverts_projection():
    pair = [camera(-0.5), camera(0.5, 620.0)]
    images = np.stack([c.project(POINTS) for c in pair])
    seen = np.ones(images.shape[:2], dtype=bool)
    np.testing.assert_allclose(triangulate(pair, images, seen, POINTS + 0.05), POINTS, atol=1e-9)


def test_wrong_input_is_refused():
    with pytest.raises(DataError, match="1 estimated cameras cannot be compared with 2"):
        evaluate([camera(0.0)], [camera(0.0), camera(1.0)], POINTS)
    with pytest.raises(DataError, match=r"shape \(3,\), it must be \(m, 3\)"):
        evaluate([camera(0.0)], [camera(0.0)], np.zeros(3))


def test_the_grid_averages_over_the_volume():
    box = Workspace((0.0, 0.0, 0.0), (2.0, 1.0, 1.0))
    grid = box.grid((4, 2, 2))
    assert grid.shape == (16, 3)
    np.testing.assert_allclose(grid.mean(axis=0), (1.0, 0.5, 0.5))
    np.testing.assert_allclose(grid.min(axis=0), (0.25, 0.25, 0.25))


def test_an_empty_box_is_refused():
    with pytest.raises(DataError, match="not longer than zero"):
        Workspace((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
