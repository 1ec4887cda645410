"""An hour of a lab: from the URDF of its arm, whose vendor's driver takes positions, to calibrated cameras.

Robot, cameras and lamp are processes of their own, which speak topics and services alone, on the computer's clock.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from im_cell.robot import cell_file, load_cell
from im_cell.rotations import matrix_of_vector
from im_core.config import package_file
from im_mcs.cell.command import main as cell_command
from support.mcs_config import write_mcs_config
from support.whole_machine import report_of, running_machine

SHIPPED = yaml.safe_load(cell_file("ur5").read_text())
CYLINDER = '<collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>'
POSES = 12


@pytest.fixture
def cell(tmp_path):
    """The cell of the lab: `im cell new`, then lines for cameras, lamp and poses."""
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    for link in ("upper_arm_link", "forearm_link"):
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{CYLINDER}')
    (tmp_path / "arm.urdf").write_text(text)
    file = tmp_path / "cell.yaml"
    assert cell_command(["new", str(tmp_path / "arm.urdf"), "--output", str(file)]) == 0
    shutil.copy(cell_file("ur5").with_name("poses.yaml"), tmp_path)
    data = yaml.safe_load(file.read_text())
    data["groups"]["arm"] |= {"light": True, "home": SHIPPED["groups"]["arm"]["home"]}
    data |= {"cameras": SHIPPED["cameras"], "led": SHIPPED["led"]}
    file.write_text(yaml.safe_dump(data))
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


def write_deployment(folder, cell):
    """Writes the machine without a testbed: the drivers of the lab take its place; its file."""
    driver = {
        "driver": "im_mcs.testbed.joint_state:CommandTopicDriver",
        "settings": {
            "joints": list(cell.joint_names),
            "state_topic": "/joint_states_of_vendor",
            "command_topic": "/forward_position_controller/commands",
            "command_joints": list(cell.joint_names),
            "period_s": 0.008,
            "silence_s": 5.0,
            "faults": [{"topic": "/vendor/safety"}],
        },
    }
    mcs = write_mcs_config(
        folder,
        testbed={"clock": "robot", "drivers": {"robot": driver}},
        control={"controller": "im_mcs.control.setpoints:SetpointPosition", "parameters": {}},
        # patience with a busy computer: positions that come in bunches look like speed
        limits={"velocity": 0.4, "following_error_rad": 0.5},
        safety={"driver_age_s": 5.0, "driver_age_estop_s": 6.0},
        servo={
            "period_s": 0.008,
            "max_overruns": 200,
            "velocity_bandwidth_rad_s": 10,
            "settle": {"tolerance": 0.005, "still_tolerance": 0.01, "window_ticks": 16, "timeout_s": 30.0},
        },
    )
    data = yaml.safe_load(mcs.read_text())
    data["slots"] = [
        {"name": name, "driver": "robot", "channel": rank, "interface": "position"}
        for rank, name in enumerate(cell.joint_names)
    ]
    mcs.write_text(yaml.safe_dump(data))
    vss = yaml.safe_load(package_file("im_vss", "config/vss.yaml").read_text())
    topics = {name: f"/{name}/image_raw" for name in cell.cameras}
    settings = {"topics": topics, "light": "/strobe"}
    vss["frame_source"] = {"implementation": "im_vss.ros.image_topics:ImageTopics", "settings": settings}
    (folder / "vss.yaml").write_text(yaml.safe_dump(vss))
    deployment = yaml.safe_load(package_file("im_bringup", "deployments/default.yaml").read_text())
    processes = deployment["hosts"]["localhost"]
    del processes["testbed"]
    processes["mcs"]["mcs"]["parameters"] = {"config": str(mcs)}
    processes["vss"]["vss"]["parameters"] = {"settings": str(folder / "vss.yaml")}
    for tasks in processes.values():
        for task in tasks.values():
            task["parameters"] = {**task.get("parameters", {}), "use_sim_time": False}
    processes["coordination"]["vision_coordinator"]["parameters"]["lights_of"] = ""
    (folder / "lab.yaml").write_text(yaml.safe_dump(deployment))
    return folder / "lab.yaml"


def test_from_a_urdf_to_calibrated_cameras(cell, process, tmp_path):
    lab = load_cell(cell)
    truth = write_truth(tmp_path, lab)
    home = ",".join(map(str, lab.home.tolist()))
    process(sys.executable, "-m", "support.vendor_robot", "--joints", ",".join(lab.joint_names), f"--home={home}")
    process(sys.executable, "-m", "support.vendor_cameras", lab.urdf, truth)
    few = yaml.safe_load(Path(tmp_path / "poses.yaml").read_text())
    few["poses"] = few["poses"][:POSES]
    (tmp_path / "few.yaml").write_text(yaml.safe_dump(few))
    with running_machine(write_deployment(tmp_path, lab), "--cell", cell) as machine:
        answer = machine.calibrate(tmp_path / "few.yaml")
        assert answer.success, answer.message
    report = report_of(answer)
    assert report["points_used"] >= POSES - 2
    true = json.loads(truth.read_text())
    for camera in report["cameras"]:
        its = true["cameras"][camera["name"]]
        assert np.array(camera["K"])[0, 0] == pytest.approx(its["K"][0][0], rel=0.02), "focal length"
    off = np.array(report["led_offset_m"]) - true["offset"]
    assert (np.abs(off) < 5.0 * np.array(report["led_offset_standard_deviation_m"]) + 1e-3).all()
