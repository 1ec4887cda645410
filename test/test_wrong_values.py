"""Made-up values in files and requests: accepted, or refused in a sentence that says where; never another error."""

import copy
import json
import re
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from im_bringup.calibration.truth import add_to_report
from im_bringup.machine import machine_state as machine
from im_bringup.tasks import deployment as deployments
from im_calibration.design import load_candidates
from im_calibration.problem.dataset import load_problems, problems
from im_calibration.targets.robot_file import read_poses
from im_calibration.targets.target import target_of
from im_cell.calibration_files import read_calibration
from im_cell.robot import load_cell
from im_cell.robot.objects import ObjectsFile
from im_cell.robot.truth import load_truth
from im_core.config import load_model, package_file
from im_core.errors import ImError
from im_dispatcher.commands.calibrate_camera import COMMAND, SYMBOL
from im_dispatcher.job import order_of
from im_dispatcher.poses_file import load_poses
from im_mcs.limits.configuration import load_config
from im_pnt.netfile import load_net
from im_pnt_analysis.simulation.replay import read_firing_sequence
from im_pnt_node.journal.strategies import read_experience
from im_vss.catalogue import load_catalogue
from im_vss.settings import load_settings

CELL = load_cell()
EYE = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
LENS = {"K": EYE, "D": [0.0] * 5, "R_cam_base": EYE, "t_cam_base_m": [0.0, 0.0, 4.0]}
TRUTH = {
    "seed": 1,
    "cameras": {"eye": {**LENS, "parent": "world", "width": 640, "height": 480}},
    "leds": {"left_led": {"offset_m": [0.0, 0.0, 0.1], "axis": [0.0, 0.0, 1.0], "diameter_m": 0.02}},
    "laser": {"rotation": EYE, "position_m": [0.0, 0.0, 4.0], "gain": [1.0, 1.0], "offset": 0.0, "gap_m": 0.02},
}
REPORT = {
    "success": True,
    "cameras": [{"name": "eye", **LENS}],
    "light": "left_led",
    "led_offset_m": [0.0, 0.0, 0.1],
    "expected_error": {"workspace_low_m": [-1.0, -1.0, 0.5], "workspace_high_m": [1.0, 1.0, 1.5]},
}
OBSERVATIONS = {
    "J_arm": [[[0.0] * 86] * 3] * 4,
    "trials": [{"x_base_m": [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.5]]}],
}
RECORD = {"pid": 77, "start": 5, "state": "ready", "phase": "START", "tasks": 3, "run_dir": "/run", "deployment": "d"}
RECORD |= {"clock_factor": 1.0, "seed": 1, "port": 8080, "missing": ["a"]}
INTRINSICS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "ceiling_left",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [600, 0, 320, 0, 600, 240, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
}
DATA_SET = {
    "schema": "vislab-calib-1",
    "image_size": [640, 480],
    "cov_x_m2": None,
    "sigma_u_px": [[0.1, 0.1]],
    "trials": [{"x_base_m": [[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]], "u_px": [[[320.0, 240.0], [330.0, 240.0]]]}],
}
NET = {"net": "n", "places": {"a": 1, "b": None}, "transitions": {"t": {"in": ["a"], "out": {"b": 1}, "weight": 2.0}}}


def own(package, file):
    """A file that we ship, as data."""
    return yaml.safe_load(package_file(package, file).read_text(encoding="utf-8"))


def truth_error(path):
    written(path.parent / "observations.json", OBSERVATIONS)
    return add_to_report(path, load_truth(written(path.parent / "truth.json", TRUTH)), CELL)


def problem():
    """What candidates are judged with."""
    (found,) = problems(DATA_SET)
    return found


def machine_record(path):
    """As the record of the machine of this test's domain is read."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "record_path", lambda: path)
        return machine.read()


URDF = package_file("im_cell", "cells/puma_pair/puma_pair.urdf").absolute()

#: For each kind of file what is right, and its reader.
FILES = {
    "deployment": (own("im_bringup", "deployments/default.yaml"), deployments.load),
    "poses": (own("im_cell", "cells/puma_pair/ceiling_40.yaml"), load_poses),
    "candidates": (own("im_cell", "cells/puma_pair/ceiling_40.yaml"), lambda path: load_candidates(path, problem())),
    "cell": ({**own("im_cell", "cells/puma_pair/cell.yaml"), "urdf": str(URDF)}, load_cell),
    "objects": (own("im_cell", "cells/puma_pair/objects.yaml"), lambda path: load_model(path, ObjectsFile)),
    "target": (
        {"target_type": "aprilgrid", "tagCols": 6, "tagRows": 5, "tagSize": 0.03, "tagSpacing": 0.3},
        lambda path: target_of(str(path)),
    ),
    "poses of a robot": (
        {"poses": [{"name": "a", "position_m": [0.1, 0.2, 0.3], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}]},
        lambda path: read_poses(path, ["a"], None, 1.0),
    ),
    "MCS": (own("im_mcs", "config/mcs.yaml"), load_config),
    "VSS": (own("im_vss", "config/vss.yaml"), lambda path: load_settings(CELL, path)),
    "Services": (own("im_vss", "config/catalogue.yaml"), load_catalogue),
    "net": (NET, load_net),
    "truth": (TRUTH, load_truth),
    "report": (REPORT, truth_error),
    "record": (RECORD, machine_record),
    "intrinsics": (INTRINSICS, lambda path: read_calibration(path.parent, CELL)),
    "data set": (DATA_SET, load_problems),
    "firing sequence": ({"sequence": ["a", "b"], "repeat_from": 1, "nets": ["n"], "marking": {"p": 1}},
                        lambda path: read_firing_sequence(str(path))),
    "strategies": ({"strategies": {"n.t": {"successes": 1, "failures": 0}}}, read_experience),
}  # fmt: skip

DECLARED = load_net(COMMAND.net).commands[SYMBOL].arguments

#: What each service of a Coordinator takes.
ASKED = [
    ("motion_coordinator", "power_up", {"group": "left"}),
    ("motion_coordinator", "power_down", {"group": "right"}),
    ("motion_coordinator", "move_robot",
     {"group": "left", "position": [1.0, 2.0, 0.5], "orientation": [0.0, 0.0, 1.0], "frame": "tool",
      "region": [0.1, 0.1, 0.0], "yaw": 0.5, "tilt": 0.1}),
    ("motion_coordinator", "find_pos", {"group": "left"}),
    ("path_planning_coordinator", "plan_path",
     {"group": "left", "destination": "destination", "region": [0.1, 0.1, 0.0], "yaw": 0.5, "tilt": 0.1}),
    ("path_planning_coordinator", "validate_path", {"group": "left", "path": "given"}),
    ("path_planning_coordinator", "order_positions", {"group": "left", "positions": "positions"}),
    ("path_planning_coordinator", "check_reach",
     {"group": "left", "position": [1.0, 2.0, 0.5], "orientation": [0.0, 0.0, 1.0], "frame": "world"}),
    ("vision_coordinator", "light_on", {"light": "left_led"}),
    ("vision_coordinator", "light_off", {"light": "left_led"}),
    ("vision_coordinator", "look", {"cameras": ["wall"], "light": "left_led", "longer": True}),
    ("vision_coordinator", "find_spot", {"cameras": ["wall"], "light": "left_led", "exposure": 0.01, "look": "7"}),
    ("vision_coordinator", "keep_observation", {"number": 1, "pose": "p1"}),
    ("vision_coordinator", "find_object", {"name": "part", "camera": "wrist_left"}),
    ("vision_coordinator", "calibrate",
     {"cameras": ["a"], "observations": [1], "rejected": {"p": "why"}, "directory": "d"}),
    ("gripper_coordinator", "open_gripper", {"gripper": "left_gripper", "width": 0.05, "force": 10}),
    ("gripper_coordinator", "close_gripper", {"gripper": "right_gripper", "force": 10}),
]  # fmt: skip


def declared(net, service):
    """What a service of a Coordinator declares."""
    return load_net(package_file("im_coordinators", f"nets/{net}.yaml")).arguments_of(service)


def checker(net, service):
    schema = declared(net, service)
    return lambda arguments: schema.check(arguments, service)


#: Likewise of requests.
REQUESTS = {
    "calibrate_camera": (
        {"cameras": ["ceiling_left"], "poses_file": ""},
        lambda arguments: order_of(DECLARED.check(arguments, SYMBOL), ["ceiling_left", "ceiling_right"]),
    ),
    **{f"{net}.{service}": (arguments, checker(net, service)) for net, service, arguments in ASKED},
}

SCALARS = (
    st.none()
    | st.booleans()
    | st.sampled_from([0, -1, 5, 2**31, 2**63, 10**25, 1e300, -1e-300, float("nan"), float("inf"), 0.5])
    | st.sampled_from(["", "\ud800", "\0", "../..", "a" * 5000, "${seed}", "1", "true", "nan", "/dev/zero", "/"])
    | st.text(max_size=4)
)
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)


def ways(data, way=()):
    """Where something stands in data."""
    yield way
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, child in children:
        yield from ways(child, (*way, key))


@st.composite
def changed(draw, right):
    """Data of which something is replaced, taken away or added."""
    data = copy.deepcopy(right)
    way = draw(st.sampled_from(list(ways(right))))
    if not way:
        return draw(VALUES)
    inner = data
    for key in way[:-1]:
        inner = inner[key]
    match draw(st.sampled_from(["replace", "replace", "replace", "take", "add"])):
        case "take":
            del inner[way[-1]]
        case "add" if isinstance(inner, dict):
            inner[draw(st.text(max_size=3))] = draw(VALUES)
        case _:
            inner[way[-1]] = draw(VALUES)
    return data


def written(path, data):
    """JSON, which YAML contains."""
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def accepted(read, given, name=""):
    """Whether something is accepted; else what is said of it must be fit for a message."""
    try:
        read(given)
    except ImError as error:
        said = error.message
    else:
        return True
    assert said.strip()
    assert len(said) < 20_000
    assert "\0" not in said
    said.encode()  # a text that is no Unicode ends the process of whoever publishes it
    assert name in said
    return False


@pytest.mark.parametrize("kind", FILES)
def test_any_value_in_a_file_is_accepted_or_refused_by_name(tmp_path, kind):
    right, read = FILES[kind]
    path = tmp_path / "ceiling_left.yaml"
    assert accepted(read, written(path, right))

    @settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
    @given(changed(right))
    def check(data):
        accepted(read, written(path, data), "" if kind == "report" else "ceiling_left.yaml")

    check()


@pytest.mark.parametrize("kind", REQUESTS)
def test_any_value_in_a_request_is_accepted_or_refused(kind):
    right, read = REQUESTS[kind]
    assert accepted(read, right)

    @settings(max_examples=100, deadline=None)
    @given(changed(right).filter(lambda data: isinstance(data, dict)))
    def check(data):
        accepted(read, data)

    check()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"cameras": 5}, "argument cameras is 5, not a list of at most 64 texts"),
        ({"cameras": [5]}, "argument cameras[0] is 5, not a text"),
        ({"cameras": None}, "argument cameras is nothing, not a list"),
        ({"cameras": ["a" * 65]}, "there is no camera 'aaaa"),
        ({"poses_file": {}}, "argument poses_file is a JSON object, not a text of at most 4096 characters"),
        ({"camera": ["ceiling_left"]}, "has no argument 'camera' (did you mean 'cameras'?)"),
    ],
)
def test_wrong_arguments_of_a_command_are_told(arguments, sentence):
    with pytest.raises(ImError) as refused:
        order_of(DECLARED.check(arguments, SYMBOL), ["ceiling_left"])
    assert sentence in refused.value.message


def test_all_readers_of_files_are_here():
    """Whoever adds a kind of file adds it above: its model is read with :func:`load_model`, or as JSON."""
    sources = Path(__file__).resolve().parent.parent / "ros_ws" / "src"
    callers = {
        path.stem
        for path in sources.glob("im_*/im_*/**/*.py")
        if re.search(r"[ (.](load_model|load_json)\(", path.read_text())
    }
    known = {"deployment", "poses_file", "design", "cell", "configuration", "settings", "catalogue", "truth"}
    known |= {"covariance", "extrinsics", "laser", "intrinsics", "folder"}  # test_calibration_files.py
    known |= {"dataset", "strategies", "config", "jsontext"}
    known |= {"proofs"}  # im_pnt_analysis/test/test_proofs.py
    known |= {"results"}  # im_calibration/test/test_report.py
    known |= {"images"}  # im_calibration/test/test_calibrate_images.py
    known |= {"target", "robot_file"}
    known |= {"file"}  # im_pnt_node/test/test_scenarios.py
    assert callers == known


def test_every_service_of_a_coordinator_says_what_it_takes():
    nets = {net for net, _, _ in ASKED}
    offered = {
        (net, name) for net in nets for name in load_net(package_file("im_coordinators", f"nets/{net}.yaml")).services
    }
    assert offered == {(net, service) for net, service, _ in ASKED}


@pytest.mark.parametrize(("net", "service", "right"), ASKED)
def test_a_coordinator_guesses_nothing(net, service, right):
    """An argument that is missing, or that it does not know, is named."""
    schema = declared(net, service)
    for name, argument in schema.arguments.items():
        if argument.required:
            with pytest.raises(ImError, match=f"{service}: argument {name} is missing, "):
                schema.check({key: value for key, value in right.items() if key != name}, service)
    with pytest.raises(ImError, match=f"{service} has no argument 'gruppe'"):
        schema.check({**right, "gruppe": "left"}, service)
