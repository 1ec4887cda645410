"""Targets in rendered images of known truth: points to hundredths of a pixel, in the right order, with their noise."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from bench.calibration.boards import Sensor, render
from im_calibration.targets.detection import detect
from im_calibration.targets.images import find_target
from im_calibration.targets.target import target_of
from im_cell.camera_model import CameraModel
from im_cell.rotations import matrix_of_vector
from im_core.errors import DataError

CAMERA = CameraModel(
    400, 300, np.array([[380.0, 0.0, 202.0], [0.0, 381.0, 147.0], [0.0, 0.0, 1.0]]),
    np.array([-0.25, 0.08, 0.001, -0.0005, 0.0]),
)  # fmt: skip


LINEAR = Sensor()


def seen(text, sensor=LINEAR, turn=(0.25, -0.2, 0.15), distance=0.5, joined=True):
    """Detection of a target in its image, and where its points are."""
    target = target_of(text)
    rotation = matrix_of_vector(turn)
    shift = np.array([0.01, -0.005, distance]) - rotation @ target.points.mean(axis=0)
    image = render(target, CAMERA, rotation, shift, sensor, joined=joined)
    return detect(image, target), CAMERA.project(target.points @ rotation.T + shift)


@pytest.mark.parametrize(
    ("text", "sensor", "px"),
    [
        ("chessboard:8x5:30mm", Sensor(), 0.02),
        ("chessboard:8x5:30mm", Sensor(blur=1.4, noise=0.02), 0.04),
        ("chessboard:8x5:30mm", Sensor(gamma=2.2), 0.02),
        ("chessboard:8x5:30mm", Sensor(bits=16), 0.02),
        ("charuco:7x5:40mm:30mm:4X4_50", Sensor(), 0.04),
        ("tags:4x3:60mm:18mm:APRILTAG_36H11", Sensor(), 0.03),
        ("tags:4x3:60mm:18mm:tag25h9", Sensor(gamma=2.2), 0.03),
        ("tags:4x3:60mm:18mm:tag16h5", Sensor(), 0.03),
        ("tags:3x2:60mm:60mm:tagStandard41h12", Sensor(), 0.1),
        ("tags:2x2:60mm:60mm:Standard41h12", Sensor(noise=0.02), 0.15),
        ("circles:7x5:35mm", Sensor(), 0.06),
        ("asymmetric_circles:4x9:22mm", Sensor(), 0.06),
    ],
)
def test_points_are_found_where_they_are(text, sensor, px):
    found, truth = seen(text, sensor)
    assert found is not None
    assert found.count >= 0.7 * len(truth)
    assert np.sqrt(np.nanmean((found.points - truth) ** 2)) < px


def test_noise_of_corners_is_told():
    found, truth = seen("chessboard:8x5:30mm", Sensor(blur=1.0, noise=0.03))
    ratio = (found.points - truth) / found.standard_deviations[:, None]
    assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.4


def test_a_board_turned_by_half_keeps_its_first_corner():
    found, truth = seen("chessboard:8x5:30mm", turn=(0.1, 0.2, np.pi))
    assert np.abs(found.points - truth).max() < 0.1
    assert not target_of("chessboard:8x5:30mm").turns_to_itself
    assert target_of("chessboard:8x6:30mm").turns_to_itself


def test_tags_as_kalibr_counts_them(tmp_path):
    file = tmp_path / "aprilgrid.yaml"
    file.write_text("target_type: 'aprilgrid'\ntagCols: 4\ntagRows: 3\ntagSize: 0.06\ntagSpacing: 0.3\n")
    target = target_of(str(file))
    assert str(target) == "tags:4x3:0.06m:0.018m:APRILTAG_36H11"
    np.testing.assert_allclose(
        target.points[:5, :2], [[0, 0.06], [0.06, 0.06], [0.06, 0], [0, 0], [0.078, 0.06]], atol=1e-12
    )  # y is upwards
    found, truth = seen(str(file), turn=(np.pi, 0.2, 0.1))
    assert np.nanmax(np.abs(found.points - truth)) < 0.1


@pytest.mark.parametrize(
    "sensor", [Sensor(), Sensor(gamma=2.2, blur=1.2), Sensor(exposure=1.8, blur=1.2)], ids=["linear", "gamma", "bright"]
)
def test_corners_of_tags_alone_do_not_depend_on_the_sensor(sensor):
    found, truth = seen("tags:4x3:60mm:18mm:tag36h11", sensor, joined=False)
    assert found.count == len(truth)
    errors = found.points - truth
    assert np.abs(errors.mean(axis=0)).max() < 0.1  # a pixel's middle is at 0 here
    assert np.sqrt(np.mean(errors**2)) < 0.15
    assert np.isnan(found.standard_deviations).all()


@pytest.mark.parametrize(("text", "other", "told"), [
    ("chessboard:8x5:30mm", "chessboard:8x6:30mm", "As {} it is found in 3 of 3: count its inner corners again"),
    ("chessboard:8x5:30mm", "chessboard:7x5:30mm", "As {} it is found in 3 of 3: count its inner corners again"),
    ("chessboard:8x5:30mm", "chessboard:4x3:30mm", "As {} it is found in 3 of 3: count its inner corners again"),
    ("chessboard:8x5:30mm", "chessboard:5x4:30mm", "As {} it is found in 3 of 3: count its inner corners again"),
    ("charuco:7x5:40mm:30mm:4X4_50", "charuco:6x4:40mm:30mm:4X4_50", "As {} it is found in 3 of 3: count its squares"),
    ("charuco:7x5:40mm:30mm:4X4_50", "charuco:7x5:40mm:30mm:6X6_50", "Markers 0 to 16 of 4X4_50 are seen, 17 numbers"),
    ("tags:4x3:60mm:18mm:tag25h9", "tags:4x3:60mm:18mm:tag36h11", "Markers 0 to 11 of APRILTAG_25H9 are seen, 12 numb"),
    ("aprilgrid", "tags:4x3:60mm:18mm:tag36h11", "As {} it is found in 3 of 3: its rows are counted from the bottom"),
])  # fmt: skip
def test_what_is_seen_in_place_of_a_target_is_told(text, other, told, tmp_path):
    target = replace(target_of(other), upwards=True) if text == "aprilgrid" else target_of(text)
    rotation = matrix_of_vector([np.pi * target.upwards, 0.1, 0.1])
    shift = np.array([0.0, 0.0, 0.5]) - rotation @ target.points.mean(axis=0)
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), render(target, CAMERA, rotation, shift, Sensor()))
    with pytest.raises(DataError, match=told.format(target)):
        find_target({"camera": tmp_path}, target_of(other))


@pytest.mark.parametrize(("text", "other"), [
    ("tags:4x3:60mm:18mm:tag25h9", "tags:3x4:60mm:18mm:tag25h9"),
    ("charuco:7x5:40mm:30mm:4X4_50", "charuco:5x7:40mm:30mm:4X4_50"),
])  # fmt: skip
def test_rows_and_columns_exchanged_are_told(text, other, tmp_path):
    target, rotation = target_of(text), matrix_of_vector([0.2, 0.1, 0.1])
    shift = np.array([0.0, 0.0, 0.5]) - rotation @ target.points.mean(axis=0)
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), render(target, CAMERA, rotation, shift, Sensor()))
    with pytest.raises(DataError, match=f"As {target} it is found in 3 of 3: rows and columns are exchanged"):
        find_target({"camera": tmp_path}, target_of(other))


def test_nothing_is_found_where_nothing_is():
    target = target_of("chessboard:8x5:30mm")
    noise = np.random.default_rng(1).integers(0, 255, (300, 400)).astype(np.uint8)
    assert detect(noise, target) is None
    assert detect(np.zeros((300, 400), dtype=np.uint8), target) is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("chesboard:9x6:25mm", "'chesboard' is no target; did you mean|'chesboard' is no target"),
        ("chessboard:9x6:25", "'25' of 'chessboard:9x6:25' is no length with a unit, such as 25mm"),
        ("chessboard:9:25mm", "is not of the form chessboard:COLUMNSxROWS:SQUARE, counted in inner corners"),
        ("chessboard:9x1:25mm", "The target has 1 rows, 2 to 100 are possible"),
        ("chessboard:9x6:25m", "A length of the target is 25 m, it must be > 0 and at most 10 m; is it in mm?"),
        ("charuco:7x5:30mm:40mm:4X4_50", "have 40 mm, they must be smaller than its squares of 30 mm"),
        ("tags:1x1:80mm:20mm:tag36h11", "The target has 4 points, at least 8 are needed"),
        ("charuco:7x5:40mm:30mm:9X9_50", "'9X9_50' is no dictionary of markers; there are 4X4_50"),
    ],
)
def test_what_is_no_target_is_told(text, told):
    with pytest.raises(DataError, match=told):
        target_of(text)
