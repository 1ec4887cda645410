"""A camera on an arm that was moved is noticed by two looks at a light, and calibrated."""

import json
import shutil

import numpy as np
import pytest
import yaml

from support.whole_machine import COMMAND_S, ROOT, running_machine

pytestmark = pytest.mark.end_to_end

MOVED_M, DIRECTION = 0.03, (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """With a calibration that is right but for the place of the camera on the wrist."""
    folder = tmp_path_factory.mktemp("moved") / "calibration"
    shutil.copytree(ROOT / "test/data/wrist_left", folder)
    poses = yaml.safe_load((folder / "extrinsics.yaml").read_text())
    shift = poses["transforms"][0]["transform"]["translation"]
    for axis, by in zip("xyz", MOVED_M * np.array(DIRECTION) / np.linalg.norm(DIRECTION), strict=True):
        shift[axis] += float(by)
    (folder / "extrinsics.yaml").write_text(yaml.safe_dump(poses))
    with running_machine("--calibration", folder) as machine:
        yield machine


def test_a_camera_moved_by_3_cm_is_noticed_and_calibrated(machine):
    done = machine.execute("check_camera")(3.0 * COMMAND_S)
    assert done.success, done.status.message
    calibrated = [(each.net, each.transition) for each in machine.firings if each.phase == each.END]
    assert calibrated.count(("check_camera", "calibrate")) == 1
    again = machine.execute("check_camera")()
    assert again.success, again.status.message
    assert not json.loads(again.results)["calibrated"]
