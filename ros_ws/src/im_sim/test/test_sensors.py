import numpy as np
import pytest

from im_cell.robot import load_cell
from im_cell.robot.truth import load_truth
from im_sim.sensors import Signals
from im_sim.truth import draw_truth

CELL = load_cell()
TRUE = CELL.home, np.zeros((2, 6)), np.zeros(2)


def test_readings_depend_on_seed_and_tick_alone():
    first, second = Signals(CELL, 3), Signals(CELL, 3)
    ticks = [0, 700, 1, 255, 256, 10_000_000]
    forwards = [np.hstack([part.ravel() for part in first.read(tick, *TRUE)]) for tick in ticks]
    backwards = [np.hstack([part.ravel() for part in second.read(tick, *TRUE)]) for tick in reversed(ticks)][::-1]
    np.testing.assert_array_equal(forwards, backwards)
    other = Signals(CELL, 4).read(0, *TRUE)
    assert all((a != b).any() for a, b in zip(first.read(0, *TRUE), other, strict=True))


def test_encoders_are_quantised_and_noisy_as_specified():
    resolution, noise = CELL.per_joint("resolution"), CELL.per_joint("noise")
    signals = Signals(CELL, 0)
    readings = np.array([signals.read(tick, *TRUE)[0] for tick in range(4000)])
    counts = readings / resolution
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    expected = np.sqrt(noise**2 + resolution**2 / 12.0)
    np.testing.assert_allclose(readings.std(axis=0), expected, rtol=0.15)
    np.testing.assert_allclose(readings.mean(axis=0), CELL.home, atol=0.05 * resolution.max())


def test_truth_is_near_the_nominal_cell_and_repeatable(tmp_path):
    truth = draw_truth(CELL, 11)
    assert truth == draw_truth(CELL, 11)
    assert truth != draw_truth(CELL, 12)
    for name, camera in CELL.cameras.items():
        true = truth.cameras[name]
        R, t = camera.pose()
        R_true = np.array(true.R_cam_base)
        np.testing.assert_allclose(R_true @ R_true.T, np.eye(3), atol=1e-12)
        angle = np.arccos(np.clip((np.trace(R_true @ R.T) - 1.0) / 2.0, -1.0, 1.0))
        assert 0.0 < angle < np.deg2rad(2.0) * np.sqrt(3.0)
        shift = R_true.T @ np.array(true.t_cam_base_m) - R.T @ t
        assert 0.0 < np.abs(shift).max() <= 0.03
        assert abs(true.K[0][0] / camera.intrinsics.fx - 1.0) < 0.02
        assert abs(true.K[0][2] - camera.intrinsics.cx) < 8.0
        assert true.D[0] == pytest.approx(-0.22, abs=0.06)
    offsets = [np.array(led.offset_m) - CELL.led.offset for led in truth.leds.values()]
    assert 0.0 < np.abs(offsets).max() < 0.015
    path = tmp_path / "truth.json"
    path.write_text(truth.model_dump_json())
    assert load_truth(path) == truth


def test_a_camera_more_changes_no_other():
    data = CELL.model_dump()
    data["cameras"] = {"another": data["cameras"]["wall"], **data["cameras"]}
    more = draw_truth(type(CELL).model_validate(data), 5)
    assert all(more.cameras[name] == camera for name, camera in draw_truth(CELL, 5).cameras.items())
