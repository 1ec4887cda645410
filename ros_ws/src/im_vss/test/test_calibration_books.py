"""What the books of cameras and laser scanner write, the next run starts with."""

import errno
import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_cell.calibration_files import CalibrationFiles, LaserEstimate, read_calibration
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import PARAMETERS, nominal
from im_cell.laser_model import LaserModel
from im_cell.robot import load_cell
from im_core.errors import DataError, NotFoundError, StoreError
from im_core.files import write_whole
from im_vss.camera_book import CameraBook
from im_vss.laser.book import LaserBook
from im_vss.services.calibrate import fixed_to

CELL = load_cell()
PAIR = ("ceiling_left", "ceiling_right")
CAMERAS = (*PAIR, "wall")


def truly(name, seed=1):
    """A camera as it may truly be."""
    rng = np.random.default_rng(seed)
    camera = nominal(CELL.cameras[name])
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix()
    K = camera.K + np.array([[7.0, 0.0, 2.0], [0.0, 8.0, -3.0], [0.0, 0.0, 0.0]]) * rng.normal()
    return replace(camera, K=K, D=rng.normal(0.0, 0.01, 5), R_cam_base=turn @ camera.R_cam_base)


def book(folder, cameras=CAMERAS):
    return CameraBook(CELL, cameras, folder, [PAIR])


def equal(entry, other):
    """Whether two entries describe the same camera; a rotation passes through a quaternion."""
    pairs = [(entry.model.K, other.model.K), (entry.model.D, other.model.D)]
    close = [
        (entry.model.R_cam_base, other.model.R_cam_base),
        (entry.model.t_cam_base, other.model.t_cam_base),
        (entry.rectified.R, other.rectified.R),
    ]
    close.append((entry.rectified.P / 600.0, other.rectified.P / 600.0))
    return all(np.array_equal(a, b) for a, b in pairs) and all(np.allclose(a, b, atol=1e-11) for a, b in close)


def test_the_next_run_has_the_cameras_of_this_one(tmp_path):
    first = book(tmp_path / "first")
    assert not first["wall"].calibrated
    assert first.set_cameras({name: truly(name) for name in PAIR}) == tmp_path / "first"
    second = book(tmp_path / "second")
    changes = []
    second.on_change = lambda: changes.append(second["ceiling_left"].calibrated)
    assert second.adopt(read_calibration(tmp_path / "first", CELL)) == ()
    assert changes == [True]
    for name in CAMERAS:
        assert equal(second[name], first[name]), name
        assert second[name].calibrated == (name in PAIR)
    assert second["ceiling_right"].rectified.P[0, 3] < -100.0
    assert second["wall"].told() == "wall: as drawn"
    assert second["ceiling_left"].told() == (
        f"ceiling_left: intrinsics {tmp_path}/first/ceiling_left.yaml, pose {tmp_path}/first/extrinsics.yaml"
    )


def test_a_run_leaves_what_it_started_with_and_what_it_found(tmp_path):
    """So its folder alone is enough for a third run."""
    book(tmp_path / "first").set_cameras({"ceiling_left": truly("ceiling_left")})
    second = book(tmp_path / "second")
    second.adopt(read_calibration(tmp_path / "first", CELL))
    second.set_cameras({"wall": truly("wall")}, pose=False)
    second.set_cameras({"ceiling_right": truly("ceiling_right")}, intrinsics=False)
    found = read_calibration(tmp_path / "second", CELL)
    assert found.summary() == "ceiling_left (intrinsics and pose), wall (intrinsics), ceiling_right (pose)"
    third = book(tmp_path / "third")
    third.adopt(found)
    assert all(equal(third[name], second[name]) for name in CAMERAS)
    assert [third[name].calibrated for name in CAMERAS] == [True, False, False]  # half is not enough
    assert third["wall"].told() == f"wall: intrinsics {tmp_path}/second/wall.yaml, pose as drawn"


def test_how_well_cameras_are_known_is_kept_and_forgotten_with_them(tmp_path):
    """Two that were calibrated together are off together; a lens that somebody sets is of nobody knows what quality."""
    joint = CameraCovariance(
        ("ceiling_left.fx", "ceiling_right.fx", "wall.fx"),
        np.array([[1.0, 0.5, 0.1], [0.5, 1.0, 0.1], [0.1, 0.1, 1.0]]),
    )
    first = book(tmp_path / "first")
    assert first.remark(PAIR).endswith("does not say how well ceiling_left and ceiling_right are known")
    first.set_cameras({name: truly(name) for name in CAMERAS}, joint)
    assert first.remark(CAMERAS) == ""
    first.set_cameras({"wall": truly("wall")}, CameraCovariance(("wall.fy",), np.array([[4.0]])))
    second = book(tmp_path / "second")
    second.adopt(read_calibration(tmp_path / "first", CELL))
    n, fx, fy = len(PARAMETERS), PARAMETERS.index("fx"), PARAMETERS.index("fy")
    for known in (first, second):
        both = known.covariance.of(["ceiling_right", "wall", "ceiling_left"])
        assert both[fx, 2 * n + fx] == both[2 * n + fx, fx] == 0.5
        assert (both[n + fx, n + fx], both[n + fy, n + fy]) == (0.0, 4.0)
        assert not both[:n, n : 2 * n].any()  # calibrated anew, without the others
    second.set_cameras({"ceiling_left": truly("ceiling_left", 2)}, pose=False)
    assert second.covariance.cameras == ("ceiling_right", "wall")
    assert second.remark(PAIR).endswith("how well ceiling_left is known")
    second.set_cameras({name: truly(name) for name in CAMERAS})
    assert not (tmp_path / "second" / "covariance.yaml").exists()


def test_a_mounted_camera_is_as_well_known_as_its_place():
    """Against poses relative to the mount of cameras that are turned and shifted as the covariance says."""
    rng, camera = np.random.default_rng(3), truly("wrist_left")
    spread = rng.normal(0.0, 1e-6, (6, 6))
    names = tuple(f"wrist_left.{name}" for name in PARAMETERS[-6:])
    mount, origin = Rotation.from_rotvec([0.4, -0.3, 0.9]).as_matrix(), np.array([0.7, -0.4, 1.1])
    nominal_pose = fixed_to(camera, mount, origin)
    moved = []
    for step in spread.T:
        turned = Rotation.from_rotvec(step[:3]).as_matrix() @ camera.R_cam_base
        there = fixed_to(replace(camera, R_cam_base=turned, t_cam_base=camera.t_cam_base + step[3:]), mount, origin)
        turn = Rotation.from_matrix(there.R_cam_base @ nominal_pose.R_cam_base.T).as_rotvec()
        moved.append(np.concatenate((turn, there.t_cam_base - nominal_pose.t_cam_base)))
    stated = CameraCovariance(names, spread @ spread.T).on_mount("wrist_left", camera.R_cam_base @ origin)
    np.testing.assert_allclose(stated.matrix, np.transpose(moved) @ np.array(moved), rtol=1e-3, atol=1e-16)


def test_without_a_calibration_nothing_is_written_and_nothing_read(tmp_path):
    book(tmp_path / "kept").set_cameras({"wall": truly("wall")})
    again = book(tmp_path / "kept")
    assert not again["wall"].calibrated
    book(tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_cameras_that_are_not_in_use_are_said(tmp_path):
    book(tmp_path / "all").set_cameras({name: truly(name) for name in CAMERAS})
    few = book(tmp_path / "few", PAIR)
    files = read_calibration(tmp_path / "all", CELL)
    assert few.adopt(files) == ("wall is not in use; its calibration is passed over",)
    assert [entry.name for entry in few.entries() if entry.calibrated] == list(PAIR)
    assert not (tmp_path / "few" / "wall.yaml").exists()


def test_what_cannot_be_written_changes_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    cameras, laser = book(tmp_path / "file"), LaserBook(CELL.laser, tmp_path / "file")
    with pytest.raises(DataError, match="file: cannot be written"):
        cameras.set_cameras({"wall": truly("wall")})
    with pytest.raises(DataError, match=r"laser.yaml: cannot be written"):
        laser.set(laser.entry.model, np.eye(10))
    assert not cameras["wall"].calibrated
    assert not laser.entry.calibrated
    with pytest.raises(NotFoundError, match="did you mean 'wall'"):
        cameras.set_cameras({"walls": truly("wall")})
    small = replace(truly("wall"), width=320)
    with pytest.raises(DataError, match="wall takes images of 640 x 480 px, the calibration is for 320 x 480 px"):
        cameras.set_cameras({"wall": small})


def read_in(folder):
    """The book of a run that is started with a folder, and the entries that it has."""
    again = book(folder.with_name(f"{folder.name}_again"))
    again.adopt(read_calibration(folder, CELL))
    return again


def same(first, second):
    return all(equal(first[name], second[name]) for name in CAMERAS) and np.array_equal(
        first.covariance.of(CAMERAS), second.covariance.of(CAMERAS)
    )


JOINT = CameraCovariance(("ceiling_left.fx", "wall.fx"), np.array([[1.0, 0.1], [0.1, 1.0]]))


@pytest.mark.parametrize("lasting", [False, True])
@pytest.mark.parametrize("written", range(8))
def test_files_that_are_not_all_written_are_all_as_before(tmp_path, monkeypatch, written, lasting):
    """A disk that is full after so many files: for a moment, or so that they cannot even be put back."""
    cameras, count = book(tmp_path / "kept"), 0

    def full(path, content):
        nonlocal count
        count += 1
        if count == written + 1 or (lasting and count > written):
            raise StoreError.of("written", path, OSError(errno.ENOSPC, "No space left on device"))
        return write_whole(path, content)

    cameras.set_cameras({name: truly(name) for name in ("ceiling_left", "wall")}, JOINT)
    LaserBook(CELL.laser, tmp_path / "kept").set(LaserModel(*CELL.laser.pose(), CELL.laser.gap), np.eye(10))
    with monkeypatch.context() as disk:
        disk.setattr("im_cell.calibration_files.together.write_whole", full)
        with pytest.raises(DataError, match="kept: cannot be written: No space left on device"):
            cameras.set_cameras({name: truly(name, 2) for name in CAMERAS})
    assert same(read_in(tmp_path / "kept"), cameras)
    assert read_calibration(tmp_path / "kept", CELL).laser is not None
    cameras.set_cameras({"wall": truly("wall", 4)})
    assert same(read_in(tmp_path / "kept"), cameras)
    assert not [path for path in (tmp_path / "kept").iterdir() if path.name.startswith(".")]


def test_a_process_that_is_killed_amid_its_files_leaves_those_before(tmp_path, monkeypatch):
    class Killed(BaseException):
        """Nothing is done after it."""

    def killed(path, content):
        if path == tmp_path / "kept" / "extrinsics.yaml":
            raise Killed
        return write_whole(path, content)

    cameras = book(tmp_path / "kept")
    cameras.set_cameras({"wall": truly("wall")}, JOINT.only({"wall"}))
    monkeypatch.setattr("im_cell.calibration_files.together.write_whole", killed)
    with pytest.raises(Killed):
        cameras.set_cameras({name: truly(name, 2) for name in CAMERAS})
    assert (tmp_path / "kept" / "ceiling_left.yaml").exists()
    assert read_calibration(tmp_path / "kept", CELL).summary() == "wall (intrinsics and pose)"
    assert same(read_in(tmp_path / "kept"), cameras)


def test_changes_at_the_same_time_are_all_kept(tmp_path):
    shared = book(tmp_path)
    models = {name: truly(name) for name in CAMERAS}
    setters = [lambda n=n: shared.set_cameras({n: models[n]}, pose=False) for n in CAMERAS]
    setters += [lambda n=n: shared.set_cameras({n: models[n]}, intrinsics=False) for n in CAMERAS]
    threads = [threading.Thread(target=setter) for setter in setters]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    again = book(tmp_path / "again")
    again.adopt(read_calibration(tmp_path, CELL))
    for name in CAMERAS:
        assert np.array_equal(shared[name].model.K, models[name].K)
        assert np.array_equal(shared[name].model.R_cam_base, models[name].R_cam_base)
        assert equal(again[name], shared[name])


def test_the_next_run_has_the_laser_of_this_one(tmp_path):
    rotation, position = CELL.laser.pose()
    estimate = LaserEstimate(LaserModel(rotation, position + 0.01, 0.0121, (1.01, 0.98), 0.002), np.eye(10) * 1e-6)
    first = LaserBook(CELL.laser, tmp_path / "first")
    first.adopt(CalibrationFiles(tmp_path, {}, {}))
    assert first.entry.told() == "laser scanner: as drawn"
    assert first.set(estimate.model, estimate.covariance) == tmp_path / "first" / "laser.yaml"
    second = LaserBook(CELL.laser, tmp_path / "second")
    second.adopt(read_calibration(tmp_path / "first", CELL))
    assert second.entry.calibrated
    assert second.entry.told() == f"laser scanner: {tmp_path}/first/laser.yaml"
    angles = np.array([[0.1, -0.05], [0.0, 0.2]])
    assert np.array_equal(second.entry.model.rays(angles), estimate.model.rays(angles))
    kept = read_calibration(tmp_path / "second", CELL).laser
    assert np.array_equal(kept.covariance, estimate.covariance)
