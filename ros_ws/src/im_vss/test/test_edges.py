"""Lines and circles on rendered plates: unbiased, and as certain as they say."""

import cv2
import numpy as np
import pytest

from im_cell.camera_model import PARAMETERS
from im_vss.edges import find_circles, find_lines
from im_vss.edges.step import undistorted

TRIALS = 25
EXACT = np.zeros((len(PARAMETERS), len(PARAMETERS)))


@pytest.fixture(scope="module")
def target(plates):
    return {target.name: target for target in plates.cell.targets}


def test_circle_is_where_its_projection_is(plates, target):
    disc, camera = target["table_disc"], plates.camera
    rotation, centre = disc.pose()
    turn = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    rim = centre + disc.size / 2.0 * np.stack([np.cos(turn), np.sin(turn)], -1) @ rotation[:, :2].T
    (u, v), axes, _ = cv2.fitEllipse(camera.project(rim).astype(np.float32))
    errors, nees = [], []
    for number in range(TRIALS):
        (circle,) = find_circles(plates.image(number), plates.settings.sensor, plates.settings.circles)
        error = np.array([circle.u - u, circle.v - v])
        errors.append(error)
        nees.append(error @ np.linalg.solve(circle.covariance, error) / 2.0)
        assert (circle.major, circle.minor) == pytest.approx((max(axes) / 2.0, min(axes) / 2.0), abs=0.15)
        assert circle.fit.contrast > 0.0  # dark on bright
    assert 0.7 < np.mean(nees) < 1.5
    assert np.abs(np.mean(errors, axis=0)).max() < 0.016


def test_line_is_where_its_projection_is(plates, target):
    edge, camera = target["table_edge"], plates.camera
    rotation, centre = edge.pose()
    ends = centre + np.array([[0.0, -edge.size / 2.0, 0.0], [0.0, edge.size / 2.0, 0.0]]) @ rotation.T
    start, end = undistorted(camera, camera.project(ends))
    along = (end - start) / np.linalg.norm(end - start)
    errors, nees = [], []
    for number in range(TRIALS):
        lines = find_lines(plates.image(number), camera, plates.settings.sensor, plates.settings.lines, EXACT)
        near = [line.edge for line in lines if np.linalg.norm(line.edge.middle - (start + end) / 2.0) < 15.0]
        (found,) = [each for each in near if abs(each.direction @ along) > 0.99]
        foot = start + along * ((found.middle - start) @ along)
        turn = np.sign(found.direction @ along) * (found.direction[0] * along[1] - found.direction[1] * along[0])
        error = np.array([(foot - found.middle) @ found.normal, turn])
        errors.append(error[0])
        nees.append(error @ np.linalg.solve(found.fit.covariance, error) / 2.0)
        brighter, darker = (found.middle + s * 4.0 * found.normal for s in (1.0, -1.0))
        image = plates.image(number)
        assert image[tuple(np.rint(brighter[::-1]).astype(int))] > image[tuple(np.rint(darker[::-1]).astype(int))]
    assert 0.6 < np.mean(nees) < 1.6
    assert abs(np.mean(errors)) < 0.02


def test_noise_holds_neither(plates):
    rng = np.random.default_rng(1)
    for _ in range(5):
        image = np.clip(rng.normal(60.0, 3.8, (480, 640)), 0, 255).astype(np.uint8)
        assert find_circles(image, plates.settings.sensor, plates.settings.circles) == []
        assert find_lines(image, plates.camera, plates.settings.sensor, plates.settings.lines, EXACT) == []
