"""Errors to expect over the image: as they are, and said where the spots leave the rim of the image alone."""

import json

import cv2
import numpy as np
import pytest
import yaml

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate, report_of, write_results
from im_calibration.judgement.expected import ImageError
from im_cell.workspace import Workspace

WIDE = Workspace((-2.4, -1.9, 0.4), (2.4, 1.9, 1.8))


@pytest.fixture(scope="module")
def filled():
    """Spots all over the image, and the scene behind."""
    scene = make_scene(Design(poses=150, cameras=1, workspace=WIDE), 1)
    return calibrate(scene.problem), scene


@pytest.fixture(scope="module")
def in_a_box():
    scene = make_scene(Design(cameras=1), 3)
    return calibrate(scene.problem), scene


def test_spots_all_over_the_image_leave_nothing_to_say(filled):
    calibration, _ = filled
    (image,) = calibration.images
    assert image.told == ""
    assert "rim" not in calibration.message
    assert image.region == (0.0, 639.0, 0.0, 479.0)


def test_a_rim_without_spots_is_said_in_message_report_and_file(in_a_box, tmp_path):
    calibration, scene = in_a_box
    (image,) = calibration.images
    assert calibration.success
    assert image.largest_px > 3.0 * image.at_spots_px
    assert f"camera_0: {image.told}." in calibration.message
    write_results(tmp_path, calibration, scene.problem)
    text = (tmp_path / "camera_0.yaml").read_text()
    assert text.startswith(f"%YAML 1.1\n---\n# {image.told}\nimage_width: 640")
    assert cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY).getNode("image_width").real() == 640
    assert yaml.safe_load(text)["camera_name"] == "camera_0"
    told = json.loads((tmp_path / "report.json").read_text())["cameras"][0]["image_error"]
    left, right, top, bottom = told["holds_within_u_u_v_v_px"]
    rows, columns = (
        [low <= at <= high for at in told[name]] for name, low, high in (("v_px", top, bottom), ("u_px", left, right))
    )
    inside = np.array(told["expected_px"], dtype=float)[np.ix_(rows, columns)]
    assert inside.size
    assert inside.max() <= image.limit_px
    assert report_of(calibration, scene.problem)["cameras"][0]["image_error"] == told


@pytest.mark.parametrize("cameras", ["filled", "in_a_box"])
def test_errors_over_the_image_are_as_expected(cameras, request):
    """Of one set, so within a factor; at the rim less, for the prior on lenses is wider than the scenes."""
    calibration, scene = request.getfixturevalue(cameras)
    (image,), model, true = calibration.images, calibration.cameras[0].model, scene.cameras[0]
    pixels = np.stack(np.meshgrid(image.u, image.v), axis=-1).reshape(-1, 2)
    depth = np.median(calibration.led_positions @ model.R_cam_base[2] + model.t_cam_base[2])
    ideal = np.column_stack((model.undistort(pixels), np.ones(len(pixels))))
    off = true.project((depth * ideal - model.t_cam_base) @ model.R_cam_base) - pixels
    ratio = np.linalg.norm(off, axis=1) / image.expected_px.ravel()
    assert 0.1 < np.sqrt((ratio**2).mean()) < 2.0


def test_where_the_lens_folds_nothing_is_promised():
    grid = np.full((3, 3), 0.1)
    grid[:, 2] = np.nan
    image = ImageError(np.array([0.0, 50.0, 100.0]), np.array([0.0, 40.0, 80.0]), grid, 0.1)
    assert image.region == (0.0, 50.0, 0.0, 80.0)
    assert "anything at the rim of the image" in image.told
