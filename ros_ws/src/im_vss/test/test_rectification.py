"""Rectified images, against those of OpenCV from the same camera info."""

import cv2
import numpy as np
import pytest

from im_cell.calibration_files.intrinsics import Rectified, monocular
from im_cell.camera_model import CameraModel
from im_vss.stereo import ImageRectification

K = np.array([[310.0, 0.0, 158.0], [0.0, 308.0, 122.0], [0.0, 0.0, 1.0]])
WIDE = CameraModel(320, 240, K, [-0.05, 0.01, -0.002, 0.0005], distortion_model="equidistant")
NARROW = CameraModel(320, 240, K, [-0.25, 0.08, 0.001, -0.0005, 0.0])
TURN = cv2.Rodrigues(np.array([0.03, -0.05, 0.02]))[0]
TURNED = Rectified(TURN, np.array([[300.0, 0.0, 160.0, -30.0], [0.0, 300.0, 120.0, 0.0], [0.0, 0.0, 1.0, 0.0]]))


@pytest.fixture
def image():
    rows, columns = np.indices((240, 320))
    return (127 + 60 * np.sin(columns / 9.0) + 60 * np.cos(rows / 7.0)).astype(np.uint8)


def of_opencv(image, model, rectified):
    make = cv2.fisheye.initUndistortRectifyMap if model is WIDE else cv2.initUndistortRectifyMap
    maps = make(model.K, model.D, rectified.R, rectified.P[:, :3], (320, 240), cv2.CV_32FC1)
    return cv2.remap(image, *maps, cv2.INTER_LINEAR)


@pytest.mark.parametrize("model", [WIDE, NARROW], ids=["equidistant", "plumb_bob"])
@pytest.mark.parametrize("turned", [False, True], ids=["alone", "of a pair"])
def test_a_rectified_image_is_that_of_opencv(image, model, turned):
    rectified = TURNED if turned else monocular(model)
    ours = ImageRectification(model, rectified).apply(image)
    assert ours.shape == image.shape
    np.testing.assert_allclose(ours.astype(int), of_opencv(image, model, rectified).astype(int), atol=2)
    assert np.abs(ours.astype(int) - image).max() > 50, "it is another image"


def test_an_image_without_distortion_stays():
    image = np.arange(240 * 320, dtype=np.uint32).astype(np.uint8).reshape(240, 320)
    ideal = CameraModel(320, 240, K, np.zeros(5))
    np.testing.assert_array_equal(ImageRectification(ideal, monocular(ideal)).apply(image), image)
