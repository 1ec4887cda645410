"""Poses of fiducial plates: within their covariance of the truth, hidden ones are missing with a cause."""

import re

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_cell.camera_model import PARAMETERS, CameraModel
from im_cell.fiducial import CELLS, code_of
from im_vss.fiducial import Corners, _linearised, find_fiducials, plate_poses

TRIALS = 40
EXACT = np.zeros((len(PARAMETERS), len(PARAMETERS)))


def test_codes_are_those_of_opencv():
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number in range(50):
        assert np.array_equal(code_of(number), cv2.aruco.generateImageMarker(dictionary, number, CELLS) > 0)


def wanted(cell):
    return {target.id: target for target in cell.targets if target.kind == "fiducial"}


def by_gamma(image):
    """Pixels as most webcams give them."""
    return np.rint(255.0 * (image / 255.0) ** (1.0 / 2.2)).astype(np.uint8)


@pytest.mark.parametrize("encode", [np.asarray, by_gamma], ids=["in proportion to the light", "gamma of 2.2"])
def test_pose_is_within_its_covariance(plates, encode):
    tag = wanted(plates.cell)[7]
    rotation, centre = tag.pose()
    true_rotation, true_place = plates.camera.R_cam_base @ rotation, plates.camera.to_camera(centre)
    nees, chi2, errors = [], [], []
    for number in range(TRIALS):
        found, missed = find_fiducials(
            [encode(plates.image(number))], plates.camera, plates.settings.sensor, wanted(plates.cell), EXACT
        )
        assert list(missed) == [11]
        assert "not seen" in missed[11]
        (fit,) = found
        turn = Rotation.from_matrix(fit.pose.rotation @ true_rotation.T).as_rotvec()
        error = np.concatenate((fit.pose.translation - true_place, turn))
        errors.append(error)
        nees.append(error @ np.linalg.solve(fit.pose.covariance, error) / 6.0)
        chi2.append(fit.pose.chi2)
        assert fit.ambiguity < 0.5
    assert 0.6 < np.mean(nees) < 1.3
    assert 1.0 < np.mean(chi2) < 3.0  # 2 degrees of freedom
    assert np.linalg.norm(np.mean(errors, axis=0)[:3]) < 0.004


def test_the_mean_of_four_images_is_twice_as_certain(plates):
    tag = wanted(plates.cell)[7]
    true_place = plates.camera.to_camera(tag.pose()[1])
    nees, shares = [], []
    for first in range(0, 4 * TRIALS, 4):
        images = [plates.image(number) for number in range(first, first + 4)]
        (one,), _ = find_fiducials(images[:1], plates.camera, plates.settings.sensor, {7: tag}, EXACT)
        (mean,), _ = find_fiducials(images, plates.camera, plates.settings.sensor, {7: tag}, EXACT)
        error, covariance = mean.pose.translation - true_place, mean.pose.covariance[:3, :3]
        nees.append(error @ np.linalg.solve(covariance, error) / 3.0)
        shares.append(np.trace(covariance) / np.trace(one.pose.covariance[:3, :3]))
    assert 0.6 < np.mean(nees) < 1.4
    assert 0.2 < np.mean(shares) < 0.4


def test_images_that_disagree_widen_the_covariance(plates):
    tag = wanted(plates.cell)[7]
    images = [plates.image(1), np.roll(plates.image(2), 2, axis=1)]
    (one,), _ = find_fiducials(images[:1], plates.camera, plates.settings.sensor, {7: tag}, EXACT)
    (mean,), _ = find_fiducials(images, plates.camera, plates.settings.sensor, {7: tag}, EXACT)
    assert np.trace(mean.pose.covariance) > 10.0 * np.trace(one.pose.covariance)


def test_a_plate_seen_in_one_of_the_images_is_found(plates):
    tag = wanted(plates.cell)[7]
    images = [np.full_like(plates.image(1), 80), plates.image(1)]
    (fit,), missed = find_fiducials(images, plates.camera, plates.settings.sensor, {7: tag}, EXACT)
    (alone,), _ = find_fiducials(images[1:], plates.camera, plates.settings.sensor, {7: tag}, EXACT)
    assert not missed
    np.testing.assert_allclose(fit.pose.translation, alone.pose.translation, atol=1e-9)


@pytest.mark.parametrize(
    "blurred", [cv2.GaussianBlur, lambda image, *_: cv2.blur(image, (9, 1))], ids=["focus", "motion"]
)
def test_what_is_blurred_too_much_has_no_pose(plates, blurred):
    image = blurred(plates.image(1), (0, 0), 2.0)
    found, missed = find_fiducials([image], plates.camera, plates.settings.sensor, wanted(plates.cell), EXACT)
    assert not found
    assert re.search(r"blurred by \d\.\d px, too much for cells of \d\.\d px|not straight|not seen", missed[7])


def test_jacobian_of_the_pose():
    rng = np.random.default_rng(2)
    rotation = Rotation.from_rotvec([2.8, 0.3, 0.4]).as_matrix()
    place, K = np.array([0.1, -0.2, 2.0]), np.array([[600.0, 0.0, 320.0], [0.0, 590.0, 240.0], [0.0, 0.0, 1.0]])
    plate = np.c_[rng.uniform(-0.1, 0.1, (4, 2)), np.zeros(4)]

    def seen(step):
        turned = Rotation.from_rotvec(step[3:]).as_matrix() @ rotation
        return -_linearised(turned, place + step[:3], plate, np.zeros((4, 2)), K)[0]

    jacobian = _linearised(rotation, place, plate, np.zeros((4, 2)), K)[1]
    numeric = np.stack([(seen(d) - seen(-d)) / 2e-6 for d in 1e-6 * np.eye(6)], axis=1)
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-5, atol=1e-4)


def test_exact_corners_give_the_exact_pose():
    camera = CameraModel(640, 480, np.array([[600.0, 0.0, 320.0], [0.0, 590.0, 240.0], [0.0, 0.0, 1.0]]), np.zeros(5))
    rotation, place = Rotation.from_rotvec([2.7, 0.4, 0.5]).as_matrix(), np.array([0.2, 0.1, 1.5])
    half = 0.1
    plate = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    corners = Corners(camera.project(plate @ rotation.T + place), 1e-4 * np.eye(8))
    best = plate_poses(corners, camera.K, 2.0 * half)[0]
    np.testing.assert_allclose(best.rotation, rotation, atol=1e-6)
    np.testing.assert_allclose(best.translation, place, atol=1e-6)
