"""The laser scanner on the running machine: against the testbed's truth, which no solver reads."""

import json
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Point
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from im_cell.calibration_files import read_calibration
from im_cell.laser_model import LaserModel
from im_cell.robot import load_cell
from im_core.ros import qos
from im_msgs.srv import LaserCalibrate, LaserPoint, LaserSpot3d, LineScan, Snap, SpotFind

CEILING = ["ceiling_left", "ceiling_right"]
TABLE_Z = 0.75
ON_TABLE = np.array([0.1, 1.1, TABLE_Z])
CELL = load_cell()
SPAN, SWEEP = [0.06, 0.12], [-0.06, 0.06]


def truth(machine):
    return json.loads((machine.folder / "truth.json").read_text())


def true_laser(machine):
    true = truth(machine)["laser"]
    rotation, position = np.array(true["rotation"]), np.array(true["position_m"])
    return LaserModel(rotation, position, true["gap_m"], tuple(true["gain"]), true["offset"])


def on_plane(model, angles, height):
    """Where the true beam meets a horizontal plane [m]."""
    start, way = model.rays(angles)
    return start + (height - start[2]) / way[2] * way


def surface(places):
    """Height of the table, or of the plate that lies there, at places, shape (n, 2 or 3) [m]."""
    heights = np.full(len(places), TABLE_Z)
    for target in (plate for plate in CELL.targets if plate.normal == (0.0, 0.0, 1.0)):
        rotation, position = target.pose()
        local = (np.asarray(places)[:, :2] - position[:2]) @ rotation[:2, :2]
        heights[np.abs(local).max(axis=1) <= 0.5 * target.plate] = position[2]
    return heights


def beam_end(model, angles):
    """Where the true beam meets the table or what lies on it [m]."""
    on_table = on_plane(model, angles, TABLE_Z)
    return on_plane(model, angles, surface(on_table[None])[0])


def xyz(point):
    return np.array([point.x, point.y, point.z])


def spot_at(machine, angles, **fields):
    return machine.call(LaserSpot3d, "/vss/laser_spot_3d", **{"cameras": CEILING, "angles": angles, **fields})


def scan(machine, **fields):
    return machine.call(LineScan, "/vss/line_scan", **{"cameras": CEILING, "span": SPAN, "sweep": SWEEP, **fields})


@pytest.fixture(scope="module")
def seeing(machine):
    """The machine, its fixed cameras calibrated as they truly are."""
    machine.calibrate_cameras(*CEILING, "wall", "table")
    return machine


@pytest.fixture(scope="module")
def calibrated(seeing):
    """The same, and the scanner calibrated by its Service; with the Service's answer."""
    answer = seeing.call(LaserCalibrate, "/vss/laser_calibrate", cameras=CEILING, apply=True)
    assert answer.success, answer.status.message
    assert answer.applied, answer.verdicts
    return seeing, answer


def test_no_point_from_cameras_as_drawn(machine):
    """First in this module: the cameras are still as the drawing has them."""
    for answer in (spot_at(machine, [0.0, 0.0]), scan(machine, lines=3)):
        assert not answer.success
        assert "not calibrated: ceiling_left, ceiling_right" in answer.status.message


def test_spot_is_where_the_beam_truly_ends(seeing):
    angles = true_laser(seeing).angles_to(ON_TABLE)
    for shift in ([0.0, 0.0], [0.02, 0.03], [-0.02, -0.05]):
        wanted = angles + shift
        answer = spot_at(seeing, wanted)
        assert answer.success, answer.status.message
        assert answer.found, answer.cause
        np.testing.assert_allclose(answer.angles, wanted, atol=1e-9)
        error = xyz(answer.point.point) - beam_end(true_laser(seeing), wanted)
        mirrors = (2.0 * CELL.laser.repeatability * 3.6) ** 2 * np.eye(3)
        covariance = np.array(answer.covariance).reshape(3, 3)
        assert error @ np.linalg.solve(covariance + mirrors, error) < 24.0  # 4 sigma, three dimensions
        assert 1e-4 < np.sqrt(covariance[2, 2]) < 2e-3
        assert answer.epipolar_distance < 0.5


def test_the_spot_is_marked_on_the_monitor(seeing):
    pictures = seeing.listen(Image, "/ceiling_left/image_display", qos.SENSOR)
    answer = spot_at(seeing, true_laser(seeing).angles_to(ON_TABLE))
    spot = next(spot for spot in answer.spots if spot.camera == "ceiling_left")
    seeing.until(lambda: any(picture.header.stamp == spot.stamp for picture in pictures))
    pixels = np.frombuffer(bytes(pictures[-1].data), np.uint8).reshape(480, 640, 3).astype(int)
    arm = pixels[round(spot.v), round(spot.u) + 8 : round(spot.u) + 17]
    assert (arm[:, 1] - arm[:, 0]).min() > 40  # green on a grey scene


def test_a_spot_that_is_not_found_has_its_cause(seeing):
    laser = true_laser(seeing)
    assert seeing.call(LaserPoint, "/vss/laser_point", angles=[0.05, 0.0]).success
    answer = spot_at(seeing, [0.0, 0.0], present=True)
    assert (answer.success, answer.found, answer.cause) == (True, False, "the laser is not lit")
    behind = spot_at(seeing, laser.angles_to([0.0, 2.4, 0.0]))
    assert "seen by neither ceiling_left and ceiling_right" in behind.cause


@pytest.mark.parametrize(
    ("kind", "service", "fields", "sentence"),
    [
        (LaserPoint, "laser_point", {"angles": [0.3, 0.0]}, "mirror1 of the laser scanner: position 0.3 rad is beyond"),
        (LaserPoint, "laser_point", {"angles": [0.0, float("nan")]}, "mirror2 of the laser scanner: position nan"),
        (LaserPoint, "laser_point", {"to_target": True, "target": Point(z=6.0)}, "the target is behind the laser"),
        (LaserPoint, "laser_point", {"to_target": True, "target": Point(x=5.0)}, "mirror2 of the laser scanner: posi"),
        (LaserSpot3d, "laser_spot_3d", {"cameras": ["wall"]}, "2 cameras are needed, got 1: wall"),
        (LaserSpot3d, "laser_spot_3d", {"cameras": ["wall", "wrist_left"]}, "wrist_left moves with left_wrist"),
        (LaserSpot3d, "laser_spot_3d", {"cameras": CEILING, "angles": [0.0, -0.5]}, "-0.5 rad is beyond the limit"),
        (LineScan, "line_scan", {"cameras": CEILING, "lines": 0}, "0 lines are not between 1 and 200"),
        (LineScan, "line_scan", {"cameras": CEILING, "lines": 2, "span": [0.1, 0.1]}, "has no length"),
        (
            LineScan,
            "line_scan",
            {"cameras": CEILING[:1], "lines": 2, "span": SPAN},
            "the laser scanner is not calibrated",
        ),
        (LaserCalibrate, "laser_calibrate", {"cameras": CEILING, "mirror1": [0.1]}, "1 angles of mirror 1 and 0 of mi"),
    ],
)
def test_wrong_requests_are_one_sentence(seeing, kind, service, fields, sentence):
    answer = seeing.call(kind, f"/vss/{service}", **fields)
    assert not answer.success
    assert sentence in answer.status.message


def test_spots_on_the_table_alone_do_not_calibrate(seeing):
    """Before the scanner is calibrated: it stays as drawn."""
    grid = np.array([[a, b] for a in (0.07, 0.09, 0.11, 0.12) for b in (-0.08, -0.03, 0.03, 0.08)])
    answer = seeing.call(
        LaserCalibrate, "/vss/laser_calibrate", cameras=CEILING, apply=True,
        mirror1=grid[:, 0].tolist(), mirror2=grid[:, 1].tolist(),
    )  # fmt: skip
    assert answer.success
    assert "UNOBSERVABLE: all spots lie within" in answer.verdicts[0]
    assert (answer.applied, answer.file) == (False, "")
    few = seeing.call(LaserCalibrate, "/vss/laser_calibrate", cameras=CEILING, mirror1=[0.1], mirror2=[0.0])
    assert "spots are fewer than 10" in few.verdicts[0]


def test_two_cameras_scan_with_a_scanner_as_drawn(seeing):
    """Before the scanner is calibrated: by stereo."""
    answer = scan(seeing, lines=5)
    assert answer.success, answer.status.message
    points = np.frombuffer(bytes(answer.cloud.data), "<f4").reshape(-1, 4).astype(float)
    assert len(points) > 100
    above = points[:, 2] - surface(points)
    assert abs(np.median(above)) < 0.001
    assert np.abs(above).max() < 0.015


def test_calibration_is_right_within_its_covariance(calibrated):
    machine, answer = calibrated
    true, q = true_laser(machine), answer.pose.orientation
    turn = Rotation.from_matrix(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix() @ true.rotation.T).as_rotvec()
    shift, gains = xyz(answer.pose.position) - true.position, np.subtract(answer.gain, true.gain)
    error = np.concatenate((turn, shift, gains, [answer.offset - true.offset, answer.gap - true.gap]))
    assert error @ np.linalg.solve(np.array(answer.covariance).reshape(10, 10), error) < 35.6  # 1 in 10,000
    assert answer.rms < 0.0006
    assert 0.4 < answer.chi2_per_dof < 2.0
    assert answer.spots_used + len(answer.rejected) == 36
    kept = read_calibration(Path(answer.file).parent, CELL)  # the next run can be started with it
    np.testing.assert_allclose(kept.laser.model.position, xyz(answer.pose.position))
    np.testing.assert_allclose(kept.laser.covariance.ravel(), answer.covariance)
    assert set(CEILING) <= set(kept.intrinsics)


def test_a_target_is_hit(calibrated):
    machine, _ = calibrated
    for shift in ([-0.2, 0.05, 0.0], [0.25, -0.1, 0.0]):
        target = ON_TABLE + shift
        place = Point(x=target[0], y=target[1], z=target[2])
        pointed = machine.call(LaserPoint, "/vss/laser_point", to_target=True, target=place, on=True)
        assert pointed.success, pointed.status.message
        assert (pointed.lit, pointed.calibrated) == (True, True)
        assert np.linalg.norm(on_plane(true_laser(machine), pointed.angles, TABLE_Z) - target) < 0.001
        seen = spot_at(machine, [0.0, 0.0], present=True)
        assert seen.found, seen.cause
        np.testing.assert_allclose(seen.angles, pointed.angles)
        assert np.linalg.norm(xyz(seen.point.point) - target) < 0.003
    light = machine.call(SpotFind, "/vss/spot_find", cameras=["ceiling_left"]).spots[0]
    assert light.cause.startswith("no light seen: left_led and right_led are off")  # the laser is no wrist light


def test_the_table_is_flat_and_where_it_is(calibrated):
    machine, _ = calibrated
    answer = scan(machine, lines=9)
    assert answer.success, answer.status.message
    cloud = answer.cloud
    assert (cloud.header.frame_id, [field.name for field in cloud.fields]) == ("world", ["x", "y", "z", "intensity"])
    assert (cloud.width, cloud.point_step, len(cloud.data)) == (answer.count, 16, 16 * answer.count)
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 4).astype(float)
    assert len(points) > 500
    assert points[:, 3].min() > 5.0
    points[:, 2] -= surface(points) - TABLE_Z
    middle = points[:, :3].mean(axis=0)
    normal = np.linalg.svd(points[:, :3] - middle, full_matrices=False)[2][2]
    assert abs(middle[2] - TABLE_Z) < 0.001
    assert np.arccos(abs(normal[2])) < 0.003
    assert ((points[:, :3] - middle) @ normal).std() < 0.004
    before = machine.call(Snap, "/vss/snap", cameras=["wall"]).images[0].header.stamp
    assert (cloud.header.stamp.sec, cloud.header.stamp.nanosec) < (before.sec, before.nanosec)
    low = scan(machine, lines=2, span=[-0.2, -0.19])
    assert low.success
    assert len(low.causes) == len(low.rejected)


def test_out_of_sight_of_which_camera(calibrated):
    machine, _ = calibrated
    answer = spot_at(machine, true_laser(machine).angles_to([-1.4, -0.9, 0.0]), cameras=["ceiling_left", "wall"])
    assert not answer.found
    assert "out of sight of wall: it would be at (" in answer.cause
    assert [spot.found for spot in answer.spots] == [True, False]
