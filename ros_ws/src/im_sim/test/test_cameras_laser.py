"""What stops the beam, and hides lights: the gripper, printed plates from both sides, whichever is first."""

from dataclasses import replace

import numpy as np
import pytest

from bench.vss.cameras import simulated
from im_cell.link import Exposure, LaserBeam
from im_cell.robot import load_cell
from im_sim.cameras.bank import CameraBank
from im_sim.cameras.laser import LaserLight
from im_sim.cameras.plates import BLACK, WHITE
from im_sim.cameras.scene import SceneMirror
from im_vss.settings import load_settings

CELL = load_cell()
SETTINGS = load_settings(CELL).model_copy(update={"cameras": ("ceiling_left",)})
PLATES = {target.name: target for target in CELL.targets}


@pytest.fixture(scope="module")
def scene():
    opened = SceneMirror(CELL, "tiny")
    opened.set_joints(CELL.home)
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def scanner(make_truth):
    return make_truth(CELL).laser.model()


def on_plate(name, x, y):
    """A place of a plate in the world [m]."""
    rotation, position = PLATES[name].pose()
    return position + rotation @ [x, y, 0.0]


@pytest.mark.parametrize(
    ("name", "place", "albedo"),
    [
        ("table_disc", (0.0, 0.0), BLACK),
        ("table_disc", (0.10, 0.10), WHITE),
        ("table_edge", (0.05, 0.0), BLACK),
        ("table_edge", (-0.05, 0.0), WHITE),
        ("table_tag", (0.11, 0.0), BLACK),
        ("board_tag", (0.22, 0.1), WHITE),
    ],
)
def test_beam_ends_on_a_plate_as_bright_as_its_print(scene, scanner, name, place, albedo):
    wanted = on_plate(name, *place)
    points, normals, found = LaserLight(CELL, scanner, scene, seed=1).ends(scanner.angles_to(wanted)[None])
    np.testing.assert_allclose(points[0], wanted, atol=1e-6)
    np.testing.assert_allclose(normals[0], PLATES[name].pose()[0][:, 2], atol=1e-9)
    assert found[0] == albedo


def test_beam_ends_on_the_back_of_a_plate_and_what_is_behind_stays_dark(scene, scanner):
    floor = np.array([0.3, 0.6, 0.0])
    start, _ = scanner.rays(scanner.angles_to(floor))
    middle = 0.5 * (start + floor)
    away = tuple((floor - start).tolist())  # the print faces the floor
    lid = PLATES["table_disc"].model_copy(update={"position": tuple(middle.tolist()), "normal": away})
    covered = CELL.model_copy(update={"targets": (*CELL.targets, lid)})
    points, normals, albedo = LaserLight(covered, scanner, scene, seed=1).ends(scanner.angles_to(floor)[None])
    np.testing.assert_allclose(points[0], middle, atol=1e-6)
    assert normals[0] @ (start - floor) > 0.0
    assert albedo[0] == WHITE
    np.testing.assert_allclose(
        LaserLight(CELL, scanner, scene, seed=1).ends(scanner.angles_to(floor)[None])[0][0], floor, atol=1e-6
    )


def test_beam_ends_on_the_gripper(scene, scanner):
    """The hand is a capsule of radius 35 mm on the last link, 50 to 150 mm from it."""
    rotation, origin = scene.pose("left_link6")
    hand = origin + rotation @ [0.0, 0.0, 0.10]
    aimed = straight_above(scanner, hand)
    points, normals, _ = LaserLight(CELL, aimed, scene, seed=1).ends(np.zeros((1, 2)))
    along = np.clip((points[0] - origin) @ rotation[:, 2], 0.05, 0.15)
    axis = origin + along * rotation[:, 2]
    assert np.linalg.norm(points[0] - axis) == pytest.approx(0.035, abs=2e-3)  # pybullet rounds up by a millimetre
    outward = (points[0] - axis) / np.linalg.norm(points[0] - axis)
    assert normals[0] @ outward == pytest.approx(1.0, abs=1e-3)


def straight_above(scanner, place):
    """The scanner half a metre above a place, looking at it with both mirrors at zero."""
    down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    return replace(scanner, rotation=down, position=place + np.array([0.0, 0.0, 0.5]))


def test_a_plate_hides_the_spot_from_a_camera_above_it(scene, scanner, make_truth):
    """A spot on the table, and a plate that stands between it and one camera but not in the beam."""
    angles = scanner.angles_to([0.3, 1.3, 0.75])
    lit = Exposure(10, 14, 0, CELL.home, {}, LaserBeam(*angles, 0.0, SETTINGS.laser.spot_power))
    dark = Exposure(10, 14, 0, CELL.home, {})
    camera = np.array(CELL.cameras["ceiling_left"].position)
    spot = np.array([0.3, 1.3, 0.75])
    between = tuple((spot + 0.5 * (camera - spot)).tolist())
    shade = PLATES["table_disc"].model_copy(update={"position": between, "name": "shade"})
    for cell, seen in ((CELL, True), (CELL.model_copy(update={"targets": (*CELL.targets, shade)}), False)):
        bank = CameraBank(cell, make_truth(cell), simulated(SETTINGS), scene, seed=1)
        images = [bank.expected("ceiling_left", shown, 0.018, SETTINGS.sensor) for shown in (lit, dark)]
        assert (np.abs(images[0] - images[1]).max() > 20.0) == seen


def test_a_plate_hides_a_wrist_light(scene, make_truth):
    seen = CameraBank(CELL, make_truth(CELL), simulated(SETTINGS), scene, seed=1).spot("ceiling_left", "left_led")
    assert seen is not None
    rotation, wrist = scene.pose("left_wrist")
    light, camera = wrist + rotation @ CELL.led.offset, np.array(CELL.cameras["ceiling_left"].position)
    between = tuple((0.5 * (light + camera)).tolist())
    shade = PLATES["table_disc"].model_copy(update={"position": between, "name": "shade"})
    shaded = CELL.model_copy(update={"targets": (*CELL.targets, shade)})
    assert (
        CameraBank(shaded, make_truth(shaded), simulated(SETTINGS), scene, seed=1).spot("ceiling_left", "left_led")
        is None
    )
