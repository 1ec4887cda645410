"""An hour of a lab: from the URDF of its arm, whose vendor's driver takes positions, to calibrated cameras.

Robot, cameras and lamp are processes of their own, which speak topics and services alone, on the computer's clock.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from im_cell.robot import cell_file, load_cell
from im_cell.rotations import matrix_of_vector
from im_core import names
from im_core.config import package_file
from im_mcs.cell.command import main as cell_command
from im_mcs.poses.command import main as find_poses
from support.whole_machine import report_of, running_machine

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "tutorials" / "your_robot.md").read_text(encoding="utf-8").partition("## Let MCS move it\n")[2]
MCS, FRAMES = map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL))
TYPED = re.findall(r"^\$ (.*)$", PAGE.partition("## Let it calibrate your cameras\n")[2], re.MULTILINE)
SHIPPED = yaml.safe_load(cell_file("ur5").read_text())
CYLINDER = '<collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>'


def words_of(line, begin, folder):
    """The arguments of a line of the page that begins so, with the folder of the test for ``lab``."""
    assert line.startswith(begin + " "), line
    return line.removeprefix(begin).replace("lab/", f"{folder}/").split()


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """The cell of the lab: the lines of the page, with cameras and lamp of the UR5.

    The URDF has neither masses nor efforts: positions need none.
    """
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    text = re.sub('effort="[^"]*"', 'effort="0"', re.sub(r"(?s)<inertial>.*?</inertial>", "", text))
    for link in ("upper_arm_link", "forearm_link"):
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{CYLINDER}')
    (tmp_path / "arm.urdf").write_text(text)
    file = tmp_path / "cell.yaml"
    assert cell_command(words_of(TYPED[0], "scripts/im cell", tmp_path)) == 0
    assert cell_command(words_of(TYPED[1], "scripts/im cell", tmp_path)) == 0
    data = yaml.safe_load(file.read_text())
    data["groups"]["arm"] |= {"light": True, "home": SHIPPED["groups"]["arm"]["home"]}
    data |= {"cameras": SHIPPED["cameras"], "led": SHIPPED["led"], "poses": "poses.yaml"}
    file.write_text(yaml.safe_dump(data))
    with monkeypatch.context() as patch:
        patch.setenv(names.CELL, str(file))
        assert find_poses(words_of(TYPED[2], "IM_CELL=lab/cell.yaml scripts/run.sh im_mcs poses", tmp_path)) == 0
    return file


def write_truth(folder, cell):
    """Writes where cameras and lamp of the lab really are: off their drawing; the file."""
    random = np.random.default_rng(5)
    cameras = {}
    for name, camera in cell.cameras.items():
        R, t = camera.pose()
        lens = camera.intrinsics
        K = [[lens.fx * 1.02, 0.0, lens.cx + 4.0], [0.0, lens.fy * 1.02, lens.cy - 3.0], [0.0, 0.0, 1.0]]
        turn = matrix_of_vector(random.normal(scale=0.01, size=3))
        cameras[name] = {"K": K, "R": (turn @ R).tolist(), "t": (turn @ t + random.normal(scale=0.01, size=3)).tolist()}
    offset = np.add(cell.led.offset, [0.003, -0.002, 0.002])
    truth = {"tip": "tool0", "light": "arm_led", "offset": offset.tolist(), "cameras": cameras}
    (folder / "truth.json").write_text(json.dumps(truth))
    return folder / "truth.json"


def write_deployment(folder):
    """Writes the machine without a testbed: the drivers of the lab take its place; its file."""
    mcs = yaml.safe_load(package_file("im_mcs", "config/mcs.yaml").read_text(encoding="utf-8"))
    for section, values in MCS.items():
        mcs[section] = values if section == "slots" else {**mcs[section], **values}
    # patience with a busy computer: positions that come in bunches look like speed
    mcs["testbed"]["drivers"]["robot"]["settings"]["silence_s"] = 5.0
    mcs["limits"] |= {"velocity": 0.4, "following_error_rad": 0.5}
    mcs["safety"] |= {"driver_age_s": 5.0, "driver_age_estop_s": 6.0}
    settle = {"tolerance": 0.005, "still_tolerance": 0.01, "window_ticks": 16, "timeout_s": 30.0}
    mcs["servo"] |= {"max_overruns": 200, "velocity_bandwidth_rad_s": 10, "settle": settle}
    (folder / "mcs.yaml").write_text(yaml.safe_dump(mcs))
    vss = yaml.safe_load(package_file("im_vss", "config/vss.yaml").read_text(encoding="utf-8"))
    (folder / "vss.yaml").write_text(yaml.safe_dump(vss | FRAMES))
    deployment = yaml.safe_load(package_file("im_bringup", "deployments/default.yaml").read_text())
    processes = deployment["hosts"]["localhost"]
    del processes["testbed"]
    processes["mcs"]["mcs"]["parameters"] = {"config": str(folder / "mcs.yaml")}
    processes["vss"]["vss"]["parameters"] = {"settings": str(folder / "vss.yaml")}
    for tasks in processes.values():
        for task in tasks.values():
            task["parameters"] = {**task.get("parameters", {}), "use_sim_time": False}
    processes["coordination"]["vision_coordinator"]["parameters"]["lights_of"] = ""
    (folder / "lab.yaml").write_text(yaml.safe_dump(deployment))
    return folder / "lab.yaml"


def test_from_a_urdf_to_calibrated_cameras(cell, process, tmp_path):
    lab = load_cell(cell)
    assert {"joint elbow_joint has no limit of effort", "link forearm_link has no mass"} <= {*lab.unknown}
    truth = write_truth(tmp_path, lab)
    home = ",".join(map(str, lab.home.tolist()))
    process(sys.executable, "-m", "support.vendor_robot", "--joints", ",".join(lab.joint_names), f"--home={home}")
    process(sys.executable, "-m", "support.vendor_cameras", lab.urdf, truth)
    write_deployment(tmp_path)
    with running_machine(*words_of(TYPED[3], "scripts/start.sh", tmp_path)) as machine:
        assert TYPED[4] == "scripts/im run calibrate_camera"
        answer = machine.calibrate(tmp_path / "poses.yaml")
        assert answer.success, answer.message
    report = report_of(answer)
    poses = yaml.safe_load((tmp_path / "poses.yaml").read_text())["poses"]
    assert report["points_used"] >= len(poses) - 2
    true = json.loads(truth.read_text())
    for camera in report["cameras"]:
        its = true["cameras"][camera["name"]]
        assert np.array(camera["K"])[0, 0] == pytest.approx(its["K"][0][0], rel=0.02), "focal length"
    off = np.array(report["led_offset_m"]) - true["offset"]
    assert (np.abs(off) < 5.0 * np.array(report["led_offset_standard_deviation_m"]) + 1e-3).all()
