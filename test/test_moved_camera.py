"""A camera on an arm that was moved is noticed by two looks at a light, and calibrated, before anything is gripped."""

import json
import math
import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest
import yaml

from im_core.config import package_file
from im_msgs.srv import GetTruth
from support.whole_machine import COMMAND_S, ROOT, running_machine

pytestmark = pytest.mark.end_to_end

MOVED_M, DIRECTION = 0.03, (1.0, 1.0, 1.0)
PART_AT, SET_DOWN = (-0.20, 1.06, 0.88), (0.5, 1.0, 0.88)
EXAMPLE = ROOT / "examples/handover.py"


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """With free bodies, and a calibration that is right but for the place of the camera on the wrist."""
    folder = tmp_path_factory.mktemp("moved") / "calibration"
    shutil.copytree(ROOT / "test/data/wrist_left", folder)
    poses = yaml.safe_load((folder / "extrinsics.yaml").read_text())
    shift = poses["transforms"][0]["transform"]["translation"]
    for axis, by in zip("xyz", MOVED_M * np.array(DIRECTION) / np.linalg.norm(DIRECTION), strict=True):
        shift[axis] += float(by)
    (folder / "extrinsics.yaml").write_text(yaml.safe_dump(poses))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
        with running_machine("--calibration", folder) as machine:
            yield machine


def test_a_camera_moved_by_3_cm_is_noticed_and_calibrated_before_the_grasp(machine, tmp_path):
    """By the example, which hands a part over as a user does."""
    machine.stand("part", PART_AT, turn=0.4)
    program = [sys.executable, EXAMPLE, "--output", tmp_path]
    done = subprocess.run(program, capture_output=True, text=True, timeout=3.0 * COMMAND_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "close the right gripper" in done.stdout
    assert cv2.imread(str(tmp_path / "handover.png")).std() > 10.0
    ended = [(each.net, each.transition) for each in machine.firings if each.phase == each.END]
    assert ended.count(("check_camera", "calibrate")) == 1
    assert ended.index(("check_camera", "calibrate")) < ended.index(("handover", "grasp.close"))
    *place, qx, qy, qz, qw = json.loads(machine.call(GetTruth, "/testbed/get_truth").json)["objects"]["part"]
    assert place == pytest.approx(SET_DOWN, abs=8e-3)  # 3 mm in most runs, see scripts/bench.sh --machine handover
    assert 2.0 * math.hypot(qx, qy) < math.radians(1.0), "upright"
    assert abs(math.sin(4.0 * 2.0 * math.atan2(qz, qw))) < math.sin(math.radians(4.0)), "with its faces along the axes"
    begin = len(machine.firings)
    again = machine.execute("check_camera")()
    assert again.success, again.status.message
    told = [(each.transition, each.message) for each in machine.firings[begin:] if each.net == "check_camera"]
    assert json.loads(again.results).get("calibrated") is False, (again.results, told)
