"""Triangulation, epipolar distance and rectification."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_cell.camera_model import PARAMETERS, nominal
from im_cell.robot import load_cell
from im_core.errors import DataError
from im_vss.camera_book import CameraBook
from im_vss.stereo import ImageRectification, epipolar_distance, rectify, triangulate

CELL = load_cell()
LEFT, RIGHT = (
    nominal(CELL.cameras[name]).__class__(
        640, 480, nominal(CELL.cameras[name]).K, np.array([-0.2, 0.04, 1e-3, -5e-4, 0.0]),
        nominal(CELL.cameras[name]).R_cam_base, nominal(CELL.cameras[name]).t_cam_base,
    )
    for name in ("ceiling_left", "ceiling_right")
)  # fmt: skip

EXACT = np.zeros((2 * len(PARAMETERS), 2 * len(PARAMETERS)))


def test_point_is_within_its_covariance():
    rng = np.random.default_rng(1)
    nees, spread = [], np.array([[0.03**2, 2e-4], [2e-4, 0.05**2]])
    for _ in range(400):
        true = rng.uniform([-0.8, -0.5, 0.6], [0.8, 0.5, 1.6])
        seen = [camera.project(true) + rng.multivariate_normal([0, 0], spread) for camera in (LEFT, RIGHT)]
        point = triangulate([LEFT, RIGHT], seen, [spread, spread], EXACT)
        error = point.position - true
        nees.append(error @ np.linalg.solve(point.covariance, error) / 3.0)
    assert np.mean(nees) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 3.0 / 400))


def test_a_point_moves_with_the_cameras_as_it_says():
    """Against the point by cameras that are a little other ones."""
    true = np.array([0.3, -0.2, 1.0])
    seen, spread = [camera.project(true) for camera in (LEFT, RIGHT)], [np.eye(2)] * 2
    point = triangulate([LEFT, RIGHT], seen, spread, EXACT)
    other = {
        "fx": lambda h: replace(RIGHT, K=RIGHT.K + h * np.diag([1.0, 0.0, 0.0])),
        "k1": lambda h: replace(RIGHT, D=RIGHT.D + np.eye(5)[0] * h),
        "ry": lambda h: replace(RIGHT, R_cam_base=Rotation.from_rotvec([0, h, 0]).as_matrix() @ RIGHT.R_cam_base),
        "tz": lambda h: replace(RIGHT, t_cam_base=RIGHT.t_cam_base + np.eye(3)[2] * h),
    }
    for name, changed in other.items():
        there, here = (triangulate([LEFT, changed(h)], seen, spread, EXACT).position for h in (1e-5, -1e-5))
        stated = point.by_cameras[:, len(PARAMETERS) + PARAMETERS.index(name)]
        np.testing.assert_allclose(stated, (there - here) / 2e-5, rtol=1e-4, atol=1e-6)


def test_epipolar_distance_is_zero_for_one_point_and_the_shift_across_the_line_else():
    true = np.array([0.2, 0.1, 1.1])
    seen = [camera.project(true) for camera in (LEFT, RIGHT)]
    assert epipolar_distance(LEFT, RIGHT, seen) == pytest.approx(0.0, abs=1e-6)
    assert epipolar_distance(LEFT, RIGHT, [seen[0], seen[1] + [0.0, 2.0]]) == pytest.approx(2.0, abs=0.2)
    further = true + 0.3 * (LEFT.position - true)  # along the ray of the left camera: no distance at all
    assert epipolar_distance(LEFT, RIGHT, [seen[0], RIGHT.project(further)]) == pytest.approx(0.0, abs=1e-6)


def test_rectified_rows_agree_and_the_baseline_gives_the_depth():
    rectified = rectify(LEFT, RIGHT)
    rng = np.random.default_rng(2)
    baseline = np.linalg.norm(LEFT.position - RIGHT.position)
    focal = rectified.left[1][0, 0]
    assert rectified.right[1][0, 3] == pytest.approx(-focal * baseline, rel=1e-9)
    assert rectified.left[1][0, 3] == 0.0
    for point in rng.uniform([-0.8, -0.5, 0.6], [0.8, 0.5, 1.6], (20, 3)):
        pixels = []
        for camera, (R, P) in ((LEFT, rectified.left), (RIGHT, rectified.right)):
            turned = R @ np.append(camera.undistort(camera.project(point)), 1.0)
            u, v, w = P[:, :3] @ turned
            pixels.append((u / w, v / w))
        assert pixels[0][1] == pytest.approx(pixels[1][1], abs=1e-6)
        depth = (rectified.left[0] @ LEFT.to_camera(point))[2]
        assert pixels[0][0] - pixels[1][0] == pytest.approx(focal * baseline / depth, rel=1e-6)


def test_camera_infos_of_a_pair_are_rectified_together_and_follow_a_calibration(tmp_path):
    book = CameraBook(CELL, ["ceiling_left", "ceiling_right", "wall"], tmp_path, [("ceiling_left", "ceiling_right")])
    baseline = np.linalg.norm(LEFT.position - RIGHT.position)
    right = book["ceiling_right"].rectified
    assert right.P[0, 3] == pytest.approx(-right.P[0, 0] * baseline)
    assert np.array_equal(book["wall"].rectified.R, np.eye(3))
    book.set_cameras({"ceiling_left": LEFT}, pose=False)
    assert not np.array_equal(book["ceiling_right"].rectified.P, right.P)
    assert (tmp_path / "ceiling_left.yaml").is_file()


def test_a_lens_that_folds_its_corners_does_not_spoil_the_image_of_the_other_camera_of_the_pair(tmp_path):
    poor = replace(RIGHT, D=np.array([-0.57, 0.32, -0.01, 0.0, -0.15]))
    assert poor.invertible_share < 1.0
    book = CameraBook(CELL, ["ceiling_left", "ceiling_right"], tmp_path, [("ceiling_left", "ceiling_right")])
    good = {}
    for right in (RIGHT, poor):
        book.set_cameras({"ceiling_left": LEFT, "ceiling_right": right})
        good[right is poor] = book["ceiling_left"].rectified
    np.testing.assert_allclose(good[True].R, good[False].R, atol=1e-9)
    # within a tenth of what a good lens gives: focal lengths and centre are of the pair's images
    np.testing.assert_allclose(good[True].P[:, :3], good[False].P[:, :3], atol=0.1 * LEFT.K[0, 0])
    white = np.full((480, 640), 200, np.uint8)
    seen = {is_poor: np.mean(ImageRectification(LEFT, each).apply(white) == 200) for is_poor, each in good.items()}
    assert seen[True] > 0.9 * seen[False] > 0.5


def test_no_pair_no_rectification(tmp_path):
    with pytest.raises(DataError, match="side by side"):
        rectify(RIGHT, LEFT)
    with pytest.raises(DataError, match="at the same place"):
        rectify(LEFT, LEFT)
    with pytest.raises(DataError, match="they move against each other"):
        CameraBook(CELL, ["wall", "wrist_left"], tmp_path, [("wall", "wrist_left")])
    with pytest.raises(DataError, match="parallel"):
        triangulate([LEFT, LEFT], [np.array([300.0, 200.0])] * 2, [np.eye(2)] * 2, EXACT)
