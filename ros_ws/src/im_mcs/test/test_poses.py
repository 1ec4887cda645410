import numpy as np
import pytest
import yaml

from im_core.robot import load_cell
from im_mcs.client.kinematics import Kinematics
from im_mcs.poses.command import main


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    path = tmp_path_factory.mktemp("poses") / "poses.yaml"
    assert main(["--count", "6", "--output", str(path)]) == 0
    return yaml.safe_load(path.read_text())


def test_poses_are_reachable_one_after_the_other(poses, config, model):
    assert poses["group"] == "left"
    assert [pose["name"] for pose in poses["poses"]] == [f"p{k}" for k in range(1, 7)]
    kinematics, cell = Kinematics(config, model), load_cell()
    q = cell.home.copy()
    for pose in poses["poses"]:
        found = kinematics.inverse("left", pose["position_m"], pose["orientation_xyzw"], [], q, True)
        kinematics.check_path("left", [q[:9].tolist(), found.tolist()], q)
        q[:9] = found


def test_the_light_faces_the_cameras_and_is_in_their_images(poses, model):
    import pinocchio as pin

    cell = load_cell()
    cameras = [cell.cameras[name] for name in ("ceiling_left", "ceiling_right")]
    middle = np.mean([camera.position for camera in cameras], axis=0)
    for pose in poses["poses"]:
        x, y, z, w = pose["orientation_xyzw"]
        rotation = pin.Quaternion(w, x, y, z).matrix()
        light = np.array(pose["position_m"]) + rotation @ np.array(cell.led.offset)
        outward = rotation @ np.array(cell.led.axis)
        towards = (middle - light) / np.linalg.norm(middle - light)
        assert outward @ towards >= np.cos(np.radians(40.1))
        assert (np.array([-1.0, -0.5, 0.6]) - 1e-3 <= light).all()
        assert (light <= np.array([1.0, 0.5, 1.6]) + 1e-3).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--group", "lefft"], "there is no group 'lefft'; did you mean 'left'"),
        (["--cameras", "ceiling"], "there is no camera 'ceiling'"),
        (["--cameras", "wrist_left"], "'wrist_left' moves with left_wrist"),
    ],
)
def test_mistakes_are_named(capsys, arguments, message):
    assert main(arguments) == 1
    assert message in capsys.readouterr().err
