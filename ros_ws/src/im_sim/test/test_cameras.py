"""The simulated cameras: light where the lens puts it, hidden by the arm, noise as stated and repeatable."""

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from bench.vss.cameras import simulated
from im_cell.camera_model import CameraModel, nominal
from im_cell.frames import FrameSourceSetup, SnapOrder
from im_cell.link import Exposure
from im_cell.robot import load_cell
from im_core import names
from im_core.errors import ConfigError, LinkError, WaitTimeoutError
from im_core.processes.process import ChildProcess
from im_core.shm import Semaphore
from im_core.shm_names import remove_all
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.host import CameraHost
from im_sim.cameras.lens import Lens
from im_sim.cameras.scene import SceneMirror
from im_sim.cameras.sensor import noise_stream, read_out
from im_vss.settings import load_settings
from im_vss.spot import find_spot

CELL = load_cell()
SETTINGS = load_settings(CELL)
DISTORTION = (-0.22, 0.04, 7e-4, -5e-4, 0.0)


@pytest.fixture(scope="module")
def bank(make_truth):
    scene = SceneMirror(CELL, "tiny")
    yield CameraBank(CELL, make_truth(CELL), simulated(SETTINGS), scene, seed=1)
    scene.close()


def exposure(q, on=1.0):
    return Exposure(start_tick=10, end_tick=14, stamp_ns=0, q_true=q, light_fraction={"left_led": on, "right_led": 0.0})


def images(bank, camera, q):
    pair = []
    for frame, on in enumerate((0.0, 1.0)):
        pair.append(np.zeros((480, 640), np.uint8))
        mean = bank.expected(camera, exposure(q, on), 0.018, SETTINGS.sensor)
        bank.read_out(camera, mean, 10, frame, pair[-1], SETTINGS.sensor)
    return pair


def test_spot_is_found_where_it_was_drawn(bank):
    off, on = images(bank, "ceiling_left", CELL.home)
    finding = find_spot(on, off, SETTINGS.sensor, SETTINGS.spot)
    spot = bank.spot("ceiling_left", "left_led")
    assert finding.spot is not None, finding.cause
    error = np.array([finding.spot.u, finding.spot.v]) - spot.uv
    assert error @ np.linalg.solve(finding.spot.covariance, error) < 25.0
    assert 60.0 < finding.spot.amplitude < 255.0


def test_arm_hides_the_light(bank):
    q = CELL.home.copy()
    bank.expected("ceiling_left", exposure(q), 0.018, SETTINGS.sensor)
    assert bank.spot("ceiling_left", "left_led") is not None
    q[CELL.joint_names.index("left_j6")] += np.pi  # the light to the other side, and below the wrist
    q[CELL.joint_names.index("left_j4")] += np.pi / 2
    hidden = []
    for turn in np.linspace(0.0, 2.0 * np.pi, 12):
        q[CELL.joint_names.index("left_j6")] = turn - np.pi
        bank.expected("ceiling_left", exposure(q), 0.018, SETTINGS.sensor)
        hidden.append(bank.spot("ceiling_left", "left_led") is None)
    assert any(hidden)
    assert not all(hidden)


def test_scene_moves_with_the_joints_and_is_rendered_once_while_they_rest(bank):
    first = bank.expected("wall", exposure(CELL.home), 0.018, SETTINGS.sensor)
    again = bank.expected("wall", exposure(CELL.home + 1e-9), 0.018, SETTINGS.sensor)
    moved = bank.expected("wall", exposure(CELL.home + 0.05), 0.018, SETTINGS.sensor)
    assert np.array_equal(first, again)
    assert np.abs(moved - first).max() > 10.0


def test_longer_exposures_are_brighter(bank):
    black = SETTINGS.sensor.black_level
    short = bank.expected("wall", exposure(CELL.home), 0.009, SETTINGS.sensor) - black
    long = bank.expected("wall", exposure(CELL.home), 0.018, SETTINGS.sensor) - black
    np.testing.assert_allclose(long, 2.0 * short, rtol=1e-4)


def test_noise_is_repeatable_and_of_its_own_stream():
    mean = np.full((60, 80), 50.0, np.float32)

    def image(*key):
        out = np.zeros(mean.shape, np.uint8)
        read_out(mean, SETTINGS.sensor, noise_stream(*key), out)
        return out

    assert np.array_equal(image(1, "wall", 10, 0), image(1, "wall", 10, 0))
    for other in ((2, "wall", 10, 0), (1, "table", 10, 0), (1, "wall", 11, 0), (1, "wall", 10, 1)):
        assert not np.array_equal(image(1, "wall", 10, 0), image(*other))


def test_noise_has_the_variance_of_the_data_sheet():
    mean = np.repeat(np.linspace(20.0, 200.0, 10, dtype=np.float32)[:, None], 20000, axis=1)
    out = np.zeros(mean.shape, np.uint8)
    read_out(mean, SETTINGS.sensor, noise_stream(1, "wall", 0, 0), out)
    np.testing.assert_allclose(out.var(axis=1), SETTINGS.sensor.variance(mean[:, 0]), rtol=0.06)
    np.testing.assert_allclose(out.mean(axis=1), mean[:, 0], atol=0.2)


def test_settings_of_the_cameras_own_are_checked():
    setup = FrameSourceSetup(CELL, ("wall",), SETTINGS.sensor, 0.018, 1.0, {"renderer": "elg"})
    with pytest.raises(ConfigError, match=r"frame_source\.settings\.renderer: 'elg': .*'egl'"):
        CameraHost(setup)
    with pytest.raises(ConfigError, match=r"frame_source\.settings\.render: .*'renderer'"):
        CameraHost(replace(setup, settings={"render": "egl"}))


def test_cameras_that_hang_at_their_start_are_ended_and_started_again(monkeypatch, tmp_path):
    started = []

    def hanging(module, arguments, log):
        settings = json.loads(arguments[arguments.index("--settings") + 1])
        started.append((ChildProcess(["sleep", "60"]), settings["renderer"]))
        return started[-1][0]

    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(ChildProcess, "of_module", hanging)
    host = CameraHost(FrameSourceSetup(CELL, ("wall",), SETTINGS.sensor, 0.018, 0.2, {"renderer": "auto"}))
    host.start()
    try:
        with pytest.raises(WaitTimeoutError, match="the camera process to be ready"):
            host.wait_ready()
        with pytest.raises(WaitTimeoutError, match="the camera process to be ready"):
            host.take_frames(SnapOrder(("wall",), (False,), 0.018, 1.0))
    finally:
        host.close()
    ended = -signal.SIGTERM
    assert [(child.poll(), renderer) for child, renderer in started] == [(ended, "auto"), (ended, "tiny")]


def test_cameras_that_cannot_be_started_again_at_once_are_later(monkeypatch, tmp_path):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(ChildProcess, "of_module", lambda *_, **__: ChildProcess(["sleep", "60"]))
    host = CameraHost(FrameSourceSetup(CELL, ("wall",), SETTINGS.sensor, 0.018, 0.2, {"renderer": "tiny"}))
    host.start()
    os.kill(host._child.pid, signal.SIGKILL)
    assert host._child.await_end(60.0)
    create = Semaphore.create
    failing = [LinkError("there is no room"), LinkError("there is no room")]

    def no_room(name):
        if failing and name.endswith("replied"):
            raise failing.pop()
        return create(name)

    monkeypatch.setattr(Semaphore, "create", no_room)
    for again in (host.revive, lambda: host.take_frames(SnapOrder(("wall",), (False,), 0.018, 1.0))):
        with pytest.raises(LinkError, match="there is no room"):
            again()
    assert "-9" in host.revive()
    assert host._child.poll() is None
    host.close()
    assert remove_all(names.instance()) == []


def test_lens_warps_as_the_camera_model_projects():
    camera = CameraModel(640, 480, nominal(CELL.cameras["wall"]).K, np.array(DISTORTION))
    lens = Lens(camera)
    K = lens.pinhole.K
    for u, v in ((60, 70), (320, 240), (590, 400)):
        image = np.zeros((480, 640), np.float32)
        image[v - 1 : v + 2, u - 1 : u + 2] = 1.0
        ideal = np.array([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1.0])
        warped = lens.warp(image)
        rows, columns = np.nonzero(warped > 0.1)
        weights = warped[rows, columns]
        centre = np.array([weights @ columns, weights @ rows]) / weights.sum()
        np.testing.assert_allclose(centre, camera.project(ideal), atol=0.1)
