"""The beam in the images: where it ends, who sees it, and lines that lie where structured light says."""

from dataclasses import replace

import numpy as np
import pytest

from bench.vss.cameras import simulated
from im_cell.camera_model import CameraModel, nominal
from im_cell.link import Exposure, LaserBeam
from im_cell.robot import load_cell
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.laser import LaserLight
from im_sim.cameras.scene import SceneMirror
from im_vss.laser.line import line_peaks, match_lines
from im_vss.settings import load_settings
from im_vss.spot import find_spot

CELL = load_cell()
SETTINGS = load_settings(CELL)
SENSOR = SETTINGS.sensor
EXPOSURE_S = SETTINGS.exposure.nominal
TABLE_Z = 0.75
POWER = SETTINGS.laser.spot_power


@pytest.fixture(scope="module")
def cell_seen(make_truth):
    """True cell, its scene, a bank of cameras."""
    truth, scene = make_truth(CELL), SceneMirror(CELL, "tiny")
    yield truth, scene, CameraBank(CELL, truth, simulated(SETTINGS), scene, seed=1)
    scene.close()


def exposed(beam, q=CELL.home):
    return Exposure(10, 14, stamp_ns=0, q_true=q, light_fraction={}, laser=beam)


def images(bank, camera, beam, q=CELL.home):
    """Frames with the beam and without it."""
    frames = []
    for number, shown in enumerate((beam, LaserBeam())):
        out = np.zeros((480, 640), np.uint8)
        bank.read_out(camera, bank.expected(camera, exposed(shown, q), EXPOSURE_S, SENSOR), 10, number, out, SENSOR)
        frames.append(out)
    return frames


def camera_of(truth, name):
    true = truth.cameras[name]
    return CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)


def test_spot_is_where_the_beam_meets_the_table(cell_seen):
    truth, _, bank = cell_seen
    model = truth.laser.model()
    for target in ([0.3, 1.0, TABLE_Z], [-0.4, 0.9, TABLE_Z], [0.05, 1.3, TABLE_Z]):
        first, second = model.angles_to(target)
        for name in ("ceiling_left", "ceiling_right"):
            finding = find_spot(*images(bank, name, LaserBeam(first, second, 0.0, POWER)), SENSOR, SETTINGS.spot)
            assert finding.spot is not None, finding.cause
            off = np.array([finding.spot.u, finding.spot.v]) - camera_of(truth, name).project(target)
            covariance = finding.spot.covariance * max(1.0, finding.spot.chi2_per_dof)
            assert off @ np.linalg.solve(covariance, off) < 20.0


def test_beam_ends_on_what_it_meets_first(cell_seen):
    truth, scene, _ = cell_seen
    model, light = truth.laser.model(), LaserLight(CELL, truth.laser.model(), scene, seed=1)
    scene.set_joints(CELL.home)
    arm = scene.pose("left_link2")[1]
    floor = [0.3, 0.6, 0.0]  # between the track and the table
    points, normals, _ = light.ends(np.array([model.angles_to(arm), model.angles_to(floor)]))
    assert points[0, 2] > arm[2]
    assert np.linalg.norm(points[0] - arm) < 0.3
    np.testing.assert_allclose(points[1], floor, atol=1e-6)
    np.testing.assert_allclose(normals[1], [0.0, 0.0, 1.0], atol=1e-9)
    start, way = model.rays(model.angles_to(arm))
    assert np.linalg.norm(np.cross(points[0] - start, way)) < 1e-6
    away = replace(model, rotation=model.rotation @ np.diag([1.0, -1.0, -1.0]))
    up, _, _ = LaserLight(CELL, away, scene, seed=1).ends(np.zeros((1, 2)))
    assert np.isnan(up).all()


def test_who_does_not_see_the_spot_has_none(cell_seen):
    truth, _, bank = cell_seen
    model = truth.laser.model()
    first, second = model.angles_to([0.3, 1.0, TABLE_Z])
    dark = bank.expected("ceiling_left", exposed(LaserBeam()), EXPOSURE_S, SENSOR)
    lit = bank.expected("ceiling_left", exposed(LaserBeam(first, second, 0.0, POWER)), EXPOSURE_S, SENSOR)
    assert (lit - dark).max() > 50.0
    behind_the_table, behind_the_camera = ("wall", [0.0, 1.95, 0.0]), ("table", [0.0, 1.48, TABLE_Z])
    for name, spot in (behind_the_table, behind_the_camera):
        first, second = model.angles_to(spot)
        seen = [
            bank.expected(name, exposed(LaserBeam(first, second, 0.0, p)), EXPOSURE_S, SENSOR) for p in (POWER, 0.0)
        ]
        np.testing.assert_array_equal(*seen)


def test_an_arm_in_the_way_of_a_camera_hides_the_spot(cell_seen):
    """Against rays of the scene from the spot to the camera, which only the robot stops."""
    truth, scene, _ = cell_seen
    light = LaserLight(CELL, truth.laser.model(), scene, seed=1)
    scene.set_joints(CELL.home)
    rng, hidden = np.random.default_rng(1), 0
    for angles in rng.uniform(-0.15, 0.15, (150, 2)):
        points, normals, _ = light.ends(angles[None])
        for name in ("ceiling_left", "ceiling_right"):
            camera = camera_of(truth, name)
            image = np.zeros((480, 640), np.float32)
            light.add(image, name, camera, exposed(LaserBeam(*angles, 0.0, POWER)))
            in_view = bool(camera.contains(camera.project(points[0])))
            robot_between = not scene.clear(points[0] + 0.004 * normals[0], camera.position)
            if in_view and robot_between:
                hidden += 1
                assert image.max() == 0.0
    assert hidden > 3


def test_line_lies_in_its_plane_of_light(cell_seen):
    truth, _, bank = cell_seen
    model, camera = truth.laser.model(), camera_of(truth, "ceiling_left")
    beam = LaserBeam(0.082, 0.03, 0.038, 0.7 * 0.038 / CELL.laser.range)
    on, off = images(bank, "ceiling_left", beam)
    peaks = line_peaks(on, off, True, SENSOR, SETTINGS.laser.line)
    assert len(peaks.pixels) > 60
    rays, normal = camera.ray(peaks.pixels), model.planes(0.03)
    points = camera.position + ((model.position - camera.position) @ normal / (rays @ normal))[:, None] * rays
    on_table = np.abs(points[:, 2] - TABLE_Z) < 0.03
    assert on_table.mean() > 0.9
    assert abs(np.median(points[on_table, 2]) - TABLE_Z) < 0.001
    assert points[on_table, 2].std() < 0.005


def test_two_cameras_agree_on_the_line_without_the_scanner(cell_seen):
    truth, _, bank = cell_seen
    names = "ceiling_left", "ceiling_right"
    beam = LaserBeam(0.082, 0.03, 0.038, 0.7 * 0.038 / CELL.laser.range)
    places = [line_peaks(*images(bank, name, beam), True, SENSOR, SETTINGS.laser.line).pixels for name in names]
    models = camera_of(truth, names[0]), camera_of(truth, names[1])
    matches = match_lines(models, *places)
    assert len(matches.points) > 0.9 * len(places[0]) - 10
    assert abs(matches.points[:, 2].mean() - TABLE_Z) < 0.001
    assert matches.points[:, 2].std() < 0.004
    assert np.abs((matches.points - truth.laser.model().position) @ truth.laser.model().planes(0.03)).max() < 0.004
    seen = models[0].project(matches.points)
    np.testing.assert_allclose(seen, places[0][matches.places], atol=0.05)
    assert len(matches.points) + sum(matches.rejected.values()) == len(places[0])


def test_lines_that_meet_behind_the_cameras_give_no_point():
    """Such as a reflection in the second camera, which crosses the epipolar line beyond what is infinitely far."""
    models = tuple(nominal(CELL.cameras[name]) for name in ("ceiling_left", "ceiling_right"))
    rng, found = np.random.default_rng(0), 0
    for _ in range(400):
        place = rng.uniform((50.0, 50.0), (600.0, 430.0))
        ray = models[0].ray(place)
        behind = models[1].to_camera(models[0].position - rng.uniform(0.3, 50.0) * ray)
        mirrored = (models[1].K[:2] @ (behind / behind[2])).ravel()
        along = models[1].project(models[0].position + 1e6 * ray) - mirrored
        across = 1.5 * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        second = np.array([mirrored - across, mirrored + across])
        if np.all((second > 0.0) & (second < 479.0)):
            matches = match_lines(models, place[None], second)
            assert len(matches.points) == len(matches.places) == 0
            found += matches.rejected.get("not within 8 m in front of both cameras", 0)
    assert found > 10


def test_speckle_is_the_same_for_the_same_beam_and_differs_for_others(cell_seen):
    _, _, bank = cell_seen
    shown = [exposed(LaserBeam(0.1, angle, 0.0, POWER)) for angle in (0.03, 0.03, 0.0300004)]
    first, same, other = (bank.expected("ceiling_left", each, EXPOSURE_S, SENSOR) for each in shown)
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1.0
