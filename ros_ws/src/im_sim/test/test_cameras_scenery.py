"""What makes images hard: vignetting, reflections, lamps that blink, plates that are hidden; and the light's centre."""

from types import SimpleNamespace

import numpy as np
import pybullet
import pytest
from scipy.optimize import least_squares

from bench.spot.trials import Lamp as Light
from bench.spot.trials import spot_image
from bench.vss.cameras import simulated
from im_cell.camera_model import CameraModel
from im_cell.link import Exposure
from im_cell.robot import Lamp, Mirror, load_cell
from im_cell.sensor import SensorControls
from im_sim.cameras import process
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.lens import Lens, vignette
from im_sim.cameras.light import reflect
from im_sim.cameras.scene import SceneMirror
from im_vss.settings import load_settings

CELL = load_cell()
SETTINGS = load_settings(CELL)
SENSOR = SETTINGS.sensor
EXPOSURE_S = SETTINGS.exposure.nominal


@pytest.fixture(scope="module")
def scene():
    made = SceneMirror(CELL, "tiny")
    yield made
    made.close()


def exposure(q=CELL.home, on=1.0, ticks=(10, 14)):
    return Exposure(*ticks, stamp_ns=0, q_true=q, light_fraction={"left_led": on, "right_led": 0.0})


def test_centre_of_the_light_is_right_to_a_fiftieth_of_a_pixel(scene, make_truth):
    """Against the true camera and the wrist's true pose, by a fit that shares nothing with the renderer."""
    truth = make_truth(CELL)
    bank = CameraBank(CELL, truth, simulated(SETTINGS), scene, seed=1)
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(12):
        q = CELL.home + rng.uniform(-0.15, 0.15, 18) * np.repeat([1.0, 0.0], 9)
        lit, dark = (bank.expected("ceiling_left", exposure(q, on), EXPOSURE_S, SENSOR) for on in (1.0, 0.0))
        true = truth.cameras["ceiling_left"]
        camera = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
        rotation, origin = scene.pose("left_wrist")
        u, v = camera.project(origin + rotation @ truth.leds["left_led"].offset_m)
        corner = np.array([round(u) - 20, round(v) - 20])
        patch = (lit - dark)[corner[1] : corner[1] + 41, corner[0] : corner[0] + 41].astype(float)
        if patch.max() < 20.0:  # hidden by the arm
            continue
        fit = least_squares(
            lambda p, patch=patch: (spot_image(Light(*p), (41, 41)) - patch).ravel(), [20.0, 20.0, 100.0, 1.2]
        )
        worst = max(worst, *np.abs(fit.x[:2] + corner - (u, v)))
    assert 0.0 < worst < 0.02


def test_scenery_drawn_apart_looks_as_if_drawn_with_the_robot(scene, make_truth, monkeypatch):
    """But for single pixels, where two faces are as near as single precision tells."""
    with monkeypatch.context() as patch:
        patch.setattr(SceneMirror, "_choose", lambda *_: ("egl", pybullet.ER_TINY_RENDERER))
        whole = SceneMirror(CELL, "tiny")
    true = make_truth(CELL).cameras["wall"]
    camera = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
    pinhole = Lens(camera, scene.renderer_offset).pinhole
    rng = np.random.default_rng(2)
    backdrop, differ = scene.backdrop(pinhole, camera), 0
    assert whole.backdrop(pinhole, camera) is None
    for _ in range(4):
        q = CELL.home + rng.uniform(-0.5, 0.5, len(CELL.home))
        for each in (scene, whole):
            each.set_joints(q)
        brightness, depth = scene.render(pinhole, camera, backdrop)
        together = whole.render(pinhole, camera, None)
        assert np.abs(depth - together[1]).max() < 1e-4
        differ += int((brightness != together[0]).sum())
    whole.close()
    assert differ < 4


def test_vignetting():
    camera = CameraModel(640, 480, [[600.0, 0, 320.0], [0, 600.0, 240.0], [0, 0, 1]], np.zeros(5))
    shade = vignette(camera, 0.2)
    assert shade[240, 320] == pytest.approx(1.0)
    assert shade[0, 0] == pytest.approx(0.8)
    assert np.all(np.diff(shade[240, 320:]) < 0.0)


def test_light_in_a_mirror_is_where_optics_say():
    mirror = Mirror(
        name="m", link="world", center=(0.0, 0.0, 0.1), axis="z", size=(1.0, 0.4), reflectance=0.5, roughness=0.0
    )
    light, eye = np.array([0.1, 0.05, 0.9]), np.array([-0.2, 0.1, 3.0])
    seen = reflect(mirror, np.eye(3), np.zeros(3), light, np.array([0.0, 0.6, 0.8]), eye)
    np.testing.assert_allclose(seen.position, [0.1, 0.05, -0.7])
    np.testing.assert_allclose(seen.axis, [0.0, 0.6, -0.8])
    into, out = light - seen.bounce, eye - seen.bounce
    cosines = into[2] / np.linalg.norm(into), out[2] / np.linalg.norm(out)
    assert cosines[0] == pytest.approx(cosines[1], abs=0.01)  # the bounce is a skin's thickness above the metal
    aside, up = np.array([2.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    assert reflect(mirror, np.eye(3), np.zeros(3), light + aside, up, eye + aside) is None
    assert reflect(mirror, np.eye(3), np.zeros(3), light * [1, 1, -1], np.array([0, 0, 1.0]), eye) is None


def test_metal_shows_the_light_a_second_time(scene, make_truth):
    floor = Mirror(
        name="f", link="world", center=(0.0, 0.0, 0.0), axis="z", size=(6.0, 6.0), reflectance=0.5, roughness=0.0
    )
    bank = CameraBank(
        CELL.model_copy(update={"mirrors": (floor,)}), make_truth(CELL), simulated(SETTINGS), scene, seed=1
    )
    q, wrist = CELL.home.copy(), CELL.joint_names.index("left_j6")
    for turn in np.linspace(-np.pi, np.pi, 13):  # until the light faces both the floor and the camera
        q[wrist] = turn
        dark, lit = (bank.expected("ceiling_left", exposure(q, on), EXPOSURE_S, SENSOR) for on in (0.0, 1.0))
        reflections = bank.reflections("ceiling_left", "left_led")
        if reflections:
            break
    (mirrored,) = reflections
    direct = bank.spot("ceiling_left", "left_led")
    assert direct is None or mirrored.flux < 0.5 * direct.flux
    u, v = np.rint(mirrored.uv).astype(int)
    assert (lit - dark)[v, u] > 10.0


def test_a_lamp_blinks_in_testbed_time(scene, make_truth):
    lamp = Lamp(name="l", position=(0.3, 0.9, 1.2), brightness=1.0, period=0.9, duty=0.5)
    bank = CameraBank(CELL.model_copy(update={"lamps": (lamp,)}), make_truth(CELL), simulated(SETTINGS), scene, seed=1)
    during = {"lit": (10, 14), "dark": (110, 114), "half": (98, 102)}  # ticks of 4.5 ms; it goes out at 0.45 s
    light = {name: bank.expected("ceiling_left", exposure(on=0.0, ticks=ticks), EXPOSURE_S, SENSOR)
             for name, ticks in during.items()}  # fmt: skip
    flash = light["lit"] - light["dark"]
    assert flash.max() > 50.0
    np.testing.assert_allclose(light["half"] - light["dark"], 0.5 * flash, atol=0.01)
    assert lamp.lit(0.0, 9.0) == pytest.approx(0.5)


def test_the_cameras_have_the_period_of_the_testbed_that_is_there(monkeypatch):
    """By it they know when an exposure was, and whether a lamp was lit then."""
    made = []
    monkeypatch.setattr(process, "CameraBank", lambda cell, *_: made.append(cell.period))
    monkeypatch.setattr(process, "_await_truth", lambda *_: SimpleNamespace(built=lambda cell: cell))
    monkeypatch.setattr(process, "SceneMirror", lambda *_: SimpleNamespace(close=lambda: None))
    cameras = process.CameraProcess.__new__(process.CameraProcess)
    cameras._cell, cameras._truth, cameras._scene = CELL, None, None
    cameras._settings = SimpleNamespace(renderer="tiny")
    for period_ns in (1_000_000, 4_500_000):
        cameras._link = SimpleNamespace(period_s=period_ns * 1e-9, seed=1)
        cameras._new_bank()
    assert made == [0.001, CELL.period]


def test_an_arm_hides_a_plate(scene, make_truth):
    bank = CameraBank(CELL, make_truth(CELL), simulated(SETTINGS), scene, seed=1)
    with_arm = bank.expected("wall", exposure(on=0.0), EXPOSURE_S, SENSOR)
    away = CELL.home.copy()
    away[CELL.joint_names.index("left_j2")] -= 0.9
    without = bank.expected("wall", exposure(away, on=0.0), EXPOSURE_S, SENSOR)
    board = next(target for target in CELL.targets if target.name == "board_tag")
    true = make_truth(CELL).cameras["wall"]
    camera = CameraModel(640, 480, true.K, true.D, true.R_cam_base, true.t_cam_base_m)
    rotation, centre = board.pose()
    low = camera.project(centre + rotation @ [-0.05, -0.21, 0.0])  # the lower margin of white paper
    u, v = np.rint(low).astype(int)
    assert abs(float(with_arm[v, u]) - float(without[v, u])) > 5.0


def test_gain_and_noise_of_a_sensor(scene, make_truth):
    bank = CameraBank(CELL, make_truth(CELL), simulated(SETTINGS), scene, seed=1)
    amplified = SensorControls(gain=2.0, noise=3.0).of(SENSOR)
    plain = bank.expected("wall", exposure(on=0.0), EXPOSURE_S, SENSOR) - SENSOR.black_level
    bright = bank.expected("wall", exposure(on=0.0), EXPOSURE_S, amplified) - SENSOR.black_level
    np.testing.assert_allclose(bright, 2.0 * plain, rtol=1e-4)
    assert amplified.variance(np.array([8.0]))[0] == pytest.approx((2.8 * 2.0 * 3.0) ** 2 + 1.0 / 12.0)
