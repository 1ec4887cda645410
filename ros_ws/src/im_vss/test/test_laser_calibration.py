"""The scanner's calibration finds the truth within its own covariance, and refuses what does not determine it."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from im_cell.laser_model import LaserModel
from im_cell.robot import load_cell
from im_vss.laser.book import LaserBook
from im_vss.laser.calibration import PARAMETERS, LaserSpot, calibrate
from im_vss.settings import load_settings
from im_vss.stereo import Point

CELL = load_cell()
SHEET = CELL.laser
GATES = load_settings(CELL).laser.calibration
EXACT = np.zeros((30, 30))
TOLERANCES = np.array([SHEET.tolerance.gain, SHEET.tolerance.gain, SHEET.tolerance.offset, SHEET.tolerance.gap])


def true_scanner(rng):
    """A scanner within the tolerances of its data sheet, mounted as well as people do."""
    rotation, position = SHEET.pose()
    first, second, offset, gap = rng.normal([1.0, 1.0, 0.0, SHEET.gap], TOLERANCES)
    return LaserModel(
        Rotation.from_rotvec(rng.uniform(-0.035, 0.035, 3)).as_matrix() @ rotation,
        position + rng.uniform(-0.03, 0.03, 3), gap, (first, second), offset,
    )  # fmt: skip


def spot(angles, place, covariance):
    """A spot by cameras that are exact."""
    return LaserSpot(angles, Point(place, covariance, covariance, np.zeros((3, len(EXACT)))))


def seen(true, rng, heights, count=30, spread=0.15):
    """Spots where beams end on horizontal planes, each with noise of its own covariance [m]."""
    spots = []
    for number in range(count):
        angles = rng.uniform(-spread, spread, 2)
        start, way = true.rays(angles + rng.normal(0.0, SHEET.repeatability, 2))
        place = start + (heights[number % len(heights)] - start[2]) / way[2] * way
        covariance = np.diag([2e-4, 2e-4, 6e-4]) ** 2
        spots.append(spot(angles, rng.multivariate_normal(place, covariance), covariance))
    return spots


def error(found, true):
    """What the estimate is off the truth, in the calibration's parameters."""
    turn = Rotation.from_matrix(found.model.rotation @ true.rotation.T).as_rotvec()
    mirrors = np.subtract(found.model.gain, true.gain)
    rest = found.model.offset - true.offset, found.model.gap - true.gap
    return np.concatenate((turn, found.model.position - true.position, mirrors, rest))


def test_truth_is_found_within_the_covariance_over_seeds():
    distances, misfits = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true = true_scanner(rng)
        found = calibrate(SHEET, seen(true, rng, (0.0, 0.4, 0.75, 1.2)), EXACT, GATES)
        assert found.verdicts == ()
        off = error(found, true)
        distances.append(off @ np.linalg.solve(found.covariance, off))
        misfits.append(found.chi2_per_dof)
    n = len(PARAMETERS)
    # Mean of 20 chi-square numbers of 10 degrees of freedom: within four of its standard deviations.
    assert abs(np.mean(distances) - n) < 4.0 * np.sqrt(2.0 * n / 20)
    assert max(distances) < chi2.ppf(1.0 - 1e-5, n)
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.1)


def test_a_calibrated_scanner_hits_what_a_drawn_one_misses():
    rng = np.random.default_rng(5)
    true = true_scanner(rng)
    found = calibrate(SHEET, seen(true, rng, (0.0, 0.4, 0.75, 1.2)), EXACT, GATES)
    target = np.array([0.2, 0.9, 0.75])

    def miss(model):
        start, way = true.rays(model.angles_to(target))
        return np.linalg.norm(np.cross(target - start, way))

    assert miss(found.model) < 0.0007
    assert miss(LaserModel(*SHEET.pose(), SHEET.gap)) > 0.01


def test_gross_errors_are_left_out_and_named():
    rng = np.random.default_rng(7)
    true = true_scanner(rng)
    spots = seen(true, rng, (0.0, 0.4, 0.75, 1.2))
    for wrong in (3, 11, 17):
        point = spots[wrong].point
        spots[wrong] = spot(spots[wrong].angles, point.position + np.array([0.05, -0.2, 0.1]), point.covariance)
    found = calibrate(SHEET, spots, EXACT, GATES)
    assert found.verdicts == ()
    assert np.flatnonzero(~found.used).tolist() == [3, 11, 17]
    off = error(found, true)
    assert off @ np.linalg.solve(found.covariance, off) < chi2.ppf(1.0 - 1e-4, len(PARAMETERS))


@pytest.mark.parametrize("seed", range(10))
def test_spots_in_one_plane_are_refused(seed):
    rng = np.random.default_rng(seed)
    found = calibrate(SHEET, seen(true_scanner(rng), rng, (0.75,)), EXACT, GATES)
    assert any("UNOBSERVABLE: all spots lie within" in verdict for verdict in found.verdicts)


def test_too_few_spots_and_too_narrow_ones_are_refused():
    rng = np.random.default_rng(2)
    true = true_scanner(rng)
    (verdict,) = calibrate(SHEET, seen(true, rng, (0.0, 0.75), count=9), EXACT, GATES).verdicts
    assert "UNOBSERVABLE: 9 spots are fewer than 10" in verdict
    assert calibrate(SHEET, [], EXACT, GATES).verdicts
    found = calibrate(SHEET, seen(true, rng, (0.0, 0.4, 1.2), spread=0.003), EXACT, GATES)
    assert any("UNOBSERVABLE" in verdict for verdict in found.verdicts)


def test_cameras_that_lie_are_a_misfit():
    rng = np.random.default_rng(3)
    spots = seen(true_scanner(rng), rng, (0.0, 0.4, 0.75, 1.2))
    points = [each.point for each in spots]
    places = [point.position + 0.003 * np.sin(9.0 * point.position[[1, 2, 0]]) for point in points]
    bent = [spot(s.angles, place, s.point.covariance) for s, place in zip(spots, places, strict=True)]
    assert any("MISFIT" in verdict for verdict in calibrate(SHEET, bent, EXACT, GATES).verdicts)


def test_the_file_holds_what_is_in_use(tmp_path):
    book = LaserBook(SHEET, tmp_path / "laser")
    assert not book.entry.calibrated
    true = true_scanner(np.random.default_rng(1))
    path = book.set(true, np.eye(10))
    stored = yaml.safe_load(path.read_text())
    assert book.entry.calibrated
    np.testing.assert_array_equal(stored["rotation"], true.rotation)
    np.testing.assert_array_equal(stored["gain"], true.gain)
    np.testing.assert_array_equal(stored["covariance"], np.eye(10))
