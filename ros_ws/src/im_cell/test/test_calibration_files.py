"""Calibrations go through files unchanged, files of other tools are read, and wrong ones are refused by name."""

import re
import shutil
from copy import deepcopy
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from im_cell.calibration_files import (
    CameraPose,
    LaserEstimate,
    camera_info_yaml,
    change_camera_files,
    covariance_yaml,
    extrinsics_yaml,
    laser_yaml,
    read_calibration,
    together,
)
from im_cell.calibration_files import folder as reading
from im_cell.camera_covariance import CameraCovariance
from im_cell.camera_model import CameraModel
from im_cell.laser_model import LaserModel
from im_cell.robot import load_cell
from im_core.errors import ConfigError

CELL = load_cell()
D = np.array([-0.2, 0.03, 1e-5, -2e-4, 1e-3])
CAMERA = CameraModel(640, 480, [[611.5, 0.0, 320.25], [0.0, 612.5, 241.125], [0.0, 0.0, 1.0]], D)
POSES = {"ceiling_left": CameraPose("world", *CELL.cameras["ceiling_left"].pose())}
LASER = LaserEstimate(LaserModel(*CELL.laser.pose(), 0.0121, (1.01, 0.99), 0.003), np.diag(np.arange(1.0, 11.0) * 1e-6))
COVARIANCE = CameraCovariance(("ceiling_left.fx", "ceiling_left.rx"), np.array([[0.25, 1e-5], [1e-5, 1e-8]]))
FOREIGN = """\
# made by camera_calibration
camera_name: narrow_stereo/left
projection_matrix: {rows: 3, cols: 4, data: [1., 0., 2., 0., 0., 1., 2., 0., 0., 0., 1., 0.]}
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 4
  data: [-0.25, 1e-05, 0.001, -0]   # as yaml-cpp writes numbers
camera_matrix:
  rows: 3
  cols: 3
  data: [611, 0, 320, 0, 612, 240, 0, 0, 1]
binning_x: 1
image_height: 480
image_width: 640
"""

numbers = st.floats(-10.0, 10.0)
turns = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: np.linalg.norm(q) > 0.1)


@pytest.fixture
def folder(tmp_path):
    """A folder with every kind of file."""
    (tmp_path / "ceiling_left.yaml").write_text(camera_info_yaml("ceiling_left", CAMERA))
    (tmp_path / "extrinsics.yaml").write_text(extrinsics_yaml(POSES))
    (tmp_path / "laser.yaml").write_text(laser_yaml(LASER))
    (tmp_path / "covariance.yaml").write_text(covariance_yaml(COVARIANCE))
    return tmp_path


def test_what_is_written_is_read(folder):
    (folder / "report.json").write_text("{}")
    found = read_calibration(folder, CELL)
    assert np.array_equal(found.intrinsics["ceiling_left"].K, CAMERA.K)
    assert np.array_equal(found.intrinsics["ceiling_left"].D, CAMERA.D)
    assert found.laser.model.gain == LASER.model.gain
    assert np.array_equal(found.laser.model.rotation, LASER.model.rotation)
    assert np.array_equal(found.laser.covariance, LASER.covariance)
    assert found.notes == ()
    assert found.summary() == "ceiling_left (intrinsics and pose), laser scanner"


@pytest.mark.parametrize("always", [False, True])
@pytest.mark.parametrize("half_changed", [False, True])
def test_files_that_are_changed_while_they_are_read_are_read_again(tmp_path, monkeypatch, half_changed, always):
    def files(f):
        camera = CameraModel(640, 480, [[f, 0.0, 320.0], [0.0, f, 240.0], [0.0, 0.0, 1.0]], D)
        return {f"{name}.yaml": camera_info_yaml(name, camera) for name in ("ceiling_left", "ceiling_right")}

    change_camera_files(tmp_path, files(600.0))
    if half_changed:  # as by a writer that is at work, or was killed
        shutil.copytree(tmp_path, tmp_path / ".before")
        (tmp_path / "ceiling_left.yaml").write_text(files(650.0)["ceiling_left.yaml"])
    read, changes = reading.read_intrinsics, iter(range(700, 10_000))

    def read_and_change(path):
        found = read(path)
        if always or not path.samefile(tmp_path / path.name) or found.model.K[0, 0] == 600.0:
            change_camera_files(tmp_path, files(float(next(changes))))
        return found

    monkeypatch.setattr(reading, "read_intrinsics", read_and_change)
    monkeypatch.setattr(together, "_READINGS", 6)
    if always:
        with pytest.raises(ConfigError, match=f"^{tmp_path}: cannot be read: its files were changed each of 6 times$"):
            read_calibration(tmp_path, CELL)
    else:
        found = read_calibration(tmp_path, CELL)
        assert {camera.K[0, 0] for camera in found.intrinsics.values()} == {700.0}


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(q=turns, t=st.tuples(numbers, numbers, numbers))
def test_poses_are_those_of_static_transform_publisher(tmp_path, q, t):
    """The file holds the camera's optical frame in its parent, as the arguments of that program do."""
    R = Rotation.from_quat(q).as_matrix()
    pose = CameraPose("left_wrist", R.T, -R.T @ np.array(t))
    text = extrinsics_yaml({"wrist_left": pose})
    (transform,) = yaml.safe_load(text)["transforms"]
    assert transform["header"]["frame_id"] == "left_wrist"
    assert transform["child_frame_id"] == "wrist_left_optical_frame"
    np.testing.assert_allclose(list(transform["transform"]["translation"].values()), t, atol=1e-9)
    turn = Rotation.from_quat([transform["transform"]["rotation"][axis] for axis in "xyzw"])
    np.testing.assert_allclose(turn.as_matrix(), R, atol=1e-12)
    (tmp_path / "extrinsics.yaml").write_text(text)
    found = read_calibration(tmp_path, CELL).poses["wrist_left"]
    np.testing.assert_allclose(found.R_cam_base, pose.R_cam_base, atol=1e-12)
    np.testing.assert_allclose(found.t_cam_base, pose.t_cam_base, atol=1e-9)


def test_the_example_of_the_documentation_is_read(tmp_path):
    documentation = Path(__file__).parents[4] / "docs" / "vss.md"
    (example,) = re.findall(r"```yaml\n(transforms:\n.*?)```", documentation.read_text(), re.DOTALL)
    (tmp_path / "extrinsics.yaml").write_text(example)
    pose = read_calibration(tmp_path, CELL).poses["ceiling_left"]
    np.testing.assert_allclose(-pose.R_cam_base.T @ pose.t_cam_base, [-0.886, -0.348, 4.172], atol=1e-9)


def test_opencv_reads_the_file_of_a_camera(folder):
    storage = cv2.FileStorage(str(folder / "ceiling_left.yaml"), cv2.FILE_STORAGE_READ)
    data = storage.getNode("camera_matrix").getNode("data")
    assert [data.at(i).real() for i in range(data.size())] == CAMERA.K.ravel().tolist()
    assert storage.getNode("image_width").real() == CAMERA.width


def test_files_of_other_tools_are_read(tmp_path):
    (tmp_path / "wall.yaml").write_text(FOREIGN)
    stamped = extrinsics_yaml(POSES).replace("{frame_id", "{stamp: {sec: 4, nanosec: 2}, frame_id")
    (tmp_path / "extrinsics.yaml").write_text(stamped)
    found = read_calibration(tmp_path, CELL)
    assert "stamp" in stamped
    assert found.intrinsics["wall"].K.tolist() == [[611.0, 0.0, 320.0], [0.0, 612.0, 240.0], [0.0, 0.0, 1.0]]
    assert found.intrinsics["wall"].D.tolist() == [-0.25, 1e-5, 0.001, 0.0, 0.0]
    assert found.notes == (f"{tmp_path}/wall.yaml: camera_name is 'narrow_stereo/left', it is taken for wall",)
    assert found.summary() == "wall (intrinsics), ceiling_left (pose)"


@pytest.mark.parametrize(
    ("file", "old", "new", "sentence"),
    [
        ("ceiling_left", "width: 640", "width: 1280", ":3: image_width: 1280: ceiling_left takes images of 640 px"),
        ("ceiling_left", "[611.5", "[.nan", ":9: camera_matrix.data[0]: nan: Input should be a finite number"),
        ("ceiling_left", "[611.5", "[-6", ":7: camera_matrix: fx is -6 px, it must be within 32 and 64000"),
        ("ceiling_left", "[611.5, 0.0", "[611.5, 0.1", "is not [fx 0 cx; 0 fy cy; 0 0 1]"),
        ("ceiling_left", "[611.5, ", "[", ":7: camera_matrix: 3 x 3 is 9 numbers, data has 8"),
        ("ceiling_left", "plumb_bob", "omni", ":10: distortion_model: 'omni': Input should be 'plumb_bob', 'rational"),
        ("ceiling_left", "plumb_bob", "equidistant", "distortion_coefficients: equidistant has 4 coefficients, got 5"),
        ("ceiling_left", "cols: 5", "cols: 8", "distortion_coefficients: 1 x 8 is 8 numbers, data has 5"),
        ("ceiling_left", "  cols: 5\n  data: [-0.2, 0.03", "  cols: 3\n  data: [0.0",
         "distortion_coefficients: 1 x 3 is 3 numbers, data has 4"),
        ("ceiling_left", "name: ceiling_left", "name: wall", ":5: camera_name: 'wall': the name of the file says c"),
        ("ceiling_left", "distortion_coefficients", "distortion", "distortion_coefficients: Field required"),
        ("ceiling_left", "camera_matrix:", "camera_matrix: [", "not YAML"),
        ("ceiling_left", "[-0.2", "[1.0e+300", ":12: distortion_coefficients: D = [1e+300, 0.03"),
        ("ceiling_left", "[-0.2", "[-20.0", "folds the image in its middle half, no lens of model plumb_bob does"),
        ("extrinsics", "translation: {x: ", "translation: {x: 1.0e+300, n: ", "translation.x: 1e+300: Input should be"),
        ("extrinsics", "frame_id: world", "frame_id: base_link", "'base_link': ceiling_left is fixed to world"),
        ("extrinsics", "left_optical", "lift_optical", ":3: transforms[0].child_frame_id: there is no camera frame 'c"),
        ("extrinsics", "rotation: {x: ", "rotation: {x: 1", ":6: transforms[0].transform.rotation: the quat"),
        ("extrinsics", "translation: {x: ", "translation: {x: .inf, n: ", "translation.x: inf: Input should be a"),
        ("extrinsics", "transforms:", "poses: 1\ntransforms:", ":1: poses: 1: Extra inputs are not permitted"),
        ("laser", "gap: 0.0121", "gap: -0.0121", "gap: -0.0121: Input should be greater than 0"),
        ("laser", "gap: 0.0121", "Gap: 0.0121", "gap: Field required"),
        ("laser", "- [1.0e-06, 0.0,", "- [-1.0e-06, 0.0,", "covariance: variances on the diagonal must be > 0"),
        ("laser", "- [1.0e-06, 0.0,", "- [1.0e-06, 1.0e-06,", "covariance: not symmetric and positive"),
        ("laser", "- [1.0e-06, 0.0,", "- [1.0e-06,", "covariance: 10 rows of 10 numbers are needed"),
        ("covariance", "left.rx", "lift.rx", ":1: parameters[1]: 'ceiling_lift.rx': there is no camera 'ceiling_lift'"),
        ("covariance", "left.rx", "left.qx", ":1: parameters[1]: 'ceiling_left.qx': a camera has fx, fy, cx, cy, k1"),
        ("covariance", "left.rx", "left.fx", ":1: parameters[1]: 'ceiling_left.fx': given twice"),
        ("covariance", "[0.25", "[-0.25", ":3: covariance: variances on the diagonal must be > 0"),
        ("covariance", "[0.25, 1.0e-05", "[0.25", ":3: covariance: 2 rows of 2 numbers are needed"),
        ("laser", "rotation:\n- [", "rotation:\n- [2", "rotation: the matrix is no rotation"),
    ],
)  # fmt: skip
def test_wrong_files_are_refused_by_file_line_and_field(folder, file, old, new, sentence):
    path = folder / f"{file}.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=f"(?m)^{re.escape(str(path))}.*{re.escape(sentence)}"):
        read_calibration(folder, CELL)


def test_how_well_a_camera_is_known_counts_with_its_lens_and_pose_only(folder):
    found = read_calibration(folder, CELL).covariance
    assert found.parameters == COVARIANCE.parameters
    np.testing.assert_array_equal(found.matrix, COVARIANCE.matrix)
    (folder / "extrinsics.yaml").unlink()
    assert read_calibration(folder, CELL).covariance.cameras == ()


def test_a_camera_placed_twice_is_refused(folder):
    path = folder / "extrinsics.yaml"
    once = path.read_text()
    path.write_text(once + once.removeprefix("transforms:\n"))
    with pytest.raises(ConfigError, match=r"transforms\[1\].child_frame_id: 'ceiling_left_optical_frame': given twice"):
        read_calibration(folder, CELL)


def test_folders_without_a_calibration_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="none: no calibration: there is no such folder"):
        read_calibration(tmp_path / "none", CELL)
    (tmp_path / "report.json").write_text('{"success": false, "message": "MISFIT: and why"}')
    with pytest.raises(ConfigError, match=r"it holds no <camera>.yaml.*; its report.json says: MISFIT: and why"):
        read_calibration(tmp_path, CELL)
    with pytest.raises(ConfigError, match=r"report.json: no calibration: it is a file, the folder around it is needed"):
        read_calibration(tmp_path / "report.json", CELL)
    (tmp_path / "ceiling_lift.yaml").write_text(FOREIGN)
    with pytest.raises(ConfigError, match=r"ceiling_lift.yaml: there is no camera 'ceiling_lift'; did you mean 'ceil"):
        read_calibration(tmp_path, CELL)


junk = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.lists(numbers, max_size=3)
)
WHOLE = {
    "ceiling_left": yaml.safe_load(camera_info_yaml("ceiling_left", CAMERA)),
    "extrinsics": yaml.safe_load(extrinsics_yaml(POSES)),
    "laser": yaml.safe_load(laser_yaml(LASER)),
}


def places(part):
    """All places of a nested structure, as (container, key)."""
    for key in list(part) if isinstance(part, dict) else range(len(part)):
        yield part, key
        if isinstance(part[key], (dict, list)):
            yield from places(part[key])


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data(), file=st.sampled_from(sorted(WHOLE)))
def test_damaged_files_are_refused_or_harmless(tmp_path_factory, data, file):
    """Whatever one field becomes: the file is refused by its name, or what is read is a calibration."""
    content = deepcopy(WHOLE[file])
    part, key = data.draw(st.sampled_from(list(places(content))))
    part[key] = data.draw(junk)
    path = tmp_path_factory.mktemp("damaged") / f"{file}.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    try:
        found = read_calibration(path.parent, CELL)
    except ConfigError as refusal:
        found, message = None, refusal.message
    if found is None:
        assert message.startswith(str(path))
        return
    for lens in found.intrinsics.values():
        assert np.isfinite(lens.K).all()
        assert np.isfinite(lens.D).all()
    for pose in found.poses.values():
        np.testing.assert_allclose(pose.R_cam_base @ pose.R_cam_base.T, np.eye(3), atol=1e-9)
    if found.laser is not None:
        assert np.linalg.eigvalsh(found.laser.covariance).min() > -1e-9
