"""The case study of the paper, section 7, on the whole machine: through every level, and what can go wrong."""

import contextlib
import itertools
import json
import math
import os
import subprocess
import sys
import threading
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from im_cell.calibration_files import read_calibration
from im_cell.robot import load_cell
from im_core.config import package_file
from im_pnt.netfile import describe, load_net
from support.permissions import allowed
from support.whole_machine import (
    COMMAND_S,
    EACH,
    FEW,
    ROOT,
    SEED,
    free_port,
    report_of,
    run_script,
    running_machine,
    write_few_poses,
)

pytestmark = pytest.mark.end_to_end

MOST_GROWTH_MIB = 200.0


@pytest.fixture(scope="module")
def few_poses(tmp_path_factory):
    return write_few_poses(tmp_path_factory.mktemp("poses"))


@pytest.fixture(scope="module")
def machine():
    with running_machine() as machine:
        yield machine


@pytest.fixture(scope="module", autouse=True)
def first_run(machine, few_poses):
    """The answer to the first command of the machine, before any other test, and the firings that led to it."""
    from im_msgs.msg import Firing

    begin = len(machine.firings)
    answer = machine.calibrate(few_poses)
    assert answer.success, answer.message

    def told():
        ended = {(f.net, f.transition) for f in machine.firings[begin:] if f.phase == Firing.END}
        return {("calibrate_camera", "loop_done"), ("calibrate_camera", "skip_done")} & ended

    machine.wait_for(told, "the last firings")
    return answer, machine.firings[begin:]


def test_a_calibration_comes_back_with_its_uncertainty(first_run, machine):
    """Service call -> nets -> torques -> pixels -> solver -> report; the truth is asked only afterwards."""
    import numpy as np

    from im_msgs.srv import GetTruth

    answer, _ = first_run
    assert answer.success, answer.message
    report = report_of(answer)
    assert {"success", "message", "points_used", "points_rejected", "cameras", "led_offset_m", "chi2_per_dof"} <= set(
        report
    )
    assert {"verdicts", "expected_error", "timing", "seed"} <= set(report)
    assert report["seed"] == SEED
    assert report["points_used"] + len(report["points_rejected"]) == FEW
    assert report["points_used"] >= FEW - 2
    assert report["verdicts"] == []
    assert [camera["name"] for camera in report["cameras"]] == ["ceiling_left", "ceiling_right"]
    truth = json.loads(machine.call(GetTruth, "/testbed/get_truth").json)
    for camera in report["cameras"]:
        true = truth["cameras"][camera["name"]]
        off = np.array(camera["K"])[0, 0] - np.array(true["K"])[0, 0]
        assert abs(off) < 0.02 * np.array(true["K"])[0, 0], "focal length"
    true_offset = np.array(truth["leds"]["left_led"]["offset_m"])
    deviation = np.array(report["led_offset_standard_deviation_m"])
    assert (np.abs(np.array(report["led_offset_m"]) - true_offset) < 5.0 * deviation + 1e-4).all()


def test_the_nets_are_the_program(first_run):
    """The firings are those of the files: one per pose, both branches of the loop, all levels."""
    from im_msgs.msg import Firing

    _, firings = first_run
    ended = [(f.net, f.transition) for f in firings if f.phase == Firing.END]
    read = [
        ("calibrate_camera", name) for name in ("read_first_pos", "read_next_pos.planned", "read_next_pos.unplanned")
    ]
    assert sum(map(ended.count, read)) == FEW
    assert ended.count(("motion_coordinator", "move_manip")) == FEW
    assert ended.count(("calibrate_camera", "loop_done")) + ended.count(("calibrate_camera", "skip_done")) == 1
    assert ended.count(("motion_coordinator", "validate_path")) == 0
    order = [
        ended.index(("calibrate_camera", name)) for name in ("init_calib", "cell.power_up", "move_robot", "find_spot")
    ]
    assert order == sorted(order)
    the_arm_goes_on_while_the_light_is_searched(firings)
    assert ended.count(("motion_coordinator", "take_path")) == FEW - 1, "paths are planned while the arm is at a pose"
    assert ended.count(("motion_coordinator", "plan_path")) == 1
    for net in {f.net for f in firings}:
        numbers = [f.sequence for f in firings if f.net == net]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), f"firings of {net} were lost"


def test_poses_in_free_order_are_visited_in_less_time_than_as_listed(first_run, few_poses):
    from im_cell.visit_order import leg_times
    from im_dispatcher.accuracy import REST_S

    answer, firings = first_run
    names = [f.transition for f in firings if f.net in {"calibrate_camera", "path_planning_coordinator"}]
    assert "order_positions" in names
    assert "note_listed" not in names
    cell, joints = load_cell(), load_cell().joints_of("left")
    listed = [
        list(cell.groups["left"].home),
        *(pose["joints"] for pose in yaml.safe_load(few_poses.read_text())["poses"]),
    ]
    as_listed = float(leg_times(cell, list(joints), listed).diagonal(1).sum())
    moving = report_of(answer)["timing"]["steps"]["calibrate_camera.move_robot"]["simulated_s"]
    assert moving - FEW * REST_S < 0.85 * as_listed


def the_arm_goes_on_while_the_light_is_searched(firings):
    """A pose is exposed when nothing is left of the one before, and the arm never moves while it is exposed."""
    from im_msgs.msg import Firing

    told = [(f.transition, f.phase) for f in firings if f.net == "calibrate_camera"]
    looks = [place for place, each in enumerate(told) if each == ("look", Firing.START)]
    assert len(looks) == FEW
    for begin, end in itertools.pairwise(looks):
        pose = told[begin:end]
        looked, goes, searches, kept = (
            pose.index(each)
            for each in (
                ("look", Firing.END),
                ("move_robot", Firing.START),
                ("find_spot", Firing.START),
                ("keep_observation.keep", Firing.END),
            )
        )
        assert looked < goes < pose.index(("move_robot", Firing.END))
        assert looked < searches < kept
        assert pose.index(("find_pos", Firing.END)) < goes
        if ("plan_ahead.plan", Firing.START) in pose:
            assert pose.index(("plan_ahead.plan", Firing.START)) < looked, "before the arm may go"
            assert pose.index(("plan_ahead.plan", Firing.END)) < goes


def test_calibration_reaches_the_standard_interfaces(first_run, machine):
    from sensor_msgs.msg import CameraInfo
    from tf2_msgs.msg import TFMessage

    from im_core.ros import qos
    from im_msgs.srv import Snap

    answer, _ = first_run
    infos = []
    machine.node.create_subscription(CameraInfo, "/ceiling_left/camera_info", infos.append, qos.EVENTS)
    cameras = ["ceiling_left"]
    machine.wait_for(
        lambda: machine.call(Snap, "/vss/snap", cameras=cameras).success and infos, "an image that is heard of"
    )
    info = infos[0]
    assert list(info.k) == pytest.approx(list(answer.report.cameras[0].k))
    assert info.distortion_model == "plumb_bob"
    frames = machine.message(TFMessage, "/tf_static", profile=qos.LATCHED_MANY)
    assert frames.transforms
    kept = read_calibration(Path(answer.report.directory), load_cell())  # the next run can be started with it
    assert kept.summary() == "ceiling_left (intrinsics and pose), ceiling_right (intrinsics and pose)"
    assert kept.intrinsics["ceiling_left"].K.ravel().tolist() == list(info.k)
    assert kept.poses["ceiling_left"].t_cam_base.tolist() == pytest.approx(list(answer.report.cameras[0].t_cam_base))


def test_the_robot_speaks_standard_messages(machine):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

    from im_core.ros import qos

    description = machine.message(String, "/robot_description", profile=qos.LATCHED).data
    assert description.startswith("<?xml")
    assert description.count('type="fixed"') > 0
    state = machine.message(JointState, "/joint_states")
    assert tuple(state.name) == (*load_cell().joint_names, "left_gripper", "right_gripper")
    assert len(state.position) == len(state.velocity) == len(state.effort) == 20
    services = dict(machine.node.get_service_names_and_types())
    assert services["/mcs/estop"] == ["std_srvs/srv/Trigger"]
    assert services["/dispatcher/calibrate_camera"] == ["im_msgs/srv/CalibrateCamera"]
    assert services["/mcs/change_state"] == ["lifecycle_msgs/srv/ChangeState"]
    assert services["/wall/set_camera_info"] == ["sensor_msgs/srv/SetCameraInfo"]


def test_the_page_of_interfaces_is_what_the_machine_offers(machine):
    written = (Path(__file__).resolve().parent.parent / "docs" / "interfaces.md").read_text()
    printed = run_script("run", "im_bringup", "interfaces").stdout
    assert printed.partition("## Topics")[0] == written.partition("## Topics")[0]
    parameters = printed.partition("## Parameters")[2].partition("## Topics")[0]
    rows = [line.split(" | ") for line in parameters.splitlines() if line.startswith("| `")]
    assert len(rows) > 20
    assert [row[0] for row in rows if not (row[1] and row[4])] == []  # each has a type and a description


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"nowhere.yaml: cannot be read"),
        ("", r":1: the file is empty"),
        ("group: left\nframe: world\nposes:\n  - {name: a, position_m: [0, 0]}\n", r":4: poses[0]"),
    ],
    ids=["missing", "empty", "malformed"],
)
def test_a_bad_poses_file_is_refused_by_name_and_line(machine, tmp_path, text, message):
    path = tmp_path / "nowhere.yaml"
    if text is not None:
        path.write_text(text)
    answer = machine.calibrate(path)
    assert not answer.success
    assert message in answer.message


def test_an_unknown_camera_is_refused_with_the_known_ones(machine):
    answer = machine.calibrate(cameras=["ceiling_lefd"])
    assert not answer.success
    assert "did you mean 'ceiling_left'?" in answer.message


def test_too_few_poses_are_refused(machine, few_poses, tmp_path):
    few = yaml.safe_load(few_poses.read_text())
    few["poses"] = few["poses"][:5]
    path = tmp_path / "five.yaml"
    path.write_text(yaml.safe_dump(few))
    answer = machine.calibrate(path)
    assert not answer.success
    assert "5 poses are too few" in answer.message


def test_a_trajectory_of_a_foreign_client_is_carried_out(machine):
    """Of one that reserves, powers and moves an arm as it would any other, while a command moves the other arm."""
    from action_msgs.msg import GoalStatus
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectoryPoint

    from im_core.ros.guard import GuardedActionClient
    from im_msgs.srv import GroupCommand, ReserveGroup

    other, owner = machine.execute("home", group="left"), {"group": "right", "owner": "stranger"}
    before = machine.message(JointState, "/joint_states")
    told = dict(zip(before.name, before.position, strict=True))
    arm = {name: told[name] for name in load_cell().joint_names if name.startswith("right_")}
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(arm)
    for share in (0.5, 1.0):
        there = [at + (0.1 * share if name == "right_j4" else 0.0) for name, at in arm.items()]
        seconds = Duration(sec=round(2 * share))
        goal.trajectory.points.append(JointTrajectoryPoint(positions=there, time_from_start=seconds))
    for word in ("reserve", "group/power_on", "group/enable_motion"):
        answer = machine.call(ReserveGroup if word == "reserve" else GroupCommand, f"/mcs/{word}", **owner)
        assert answer.success, answer.message
    client = GuardedActionClient(machine.node, FollowJointTrajectory, "/right/follow_joint_trajectory")
    try:
        machine.wait_for(client.server_is_ready, "the action")
        sent = client.send_goal_async(goal)
        machine.wait_for(sent.done, "the goal to be accepted")
        ended = sent.result().get_result_async()
        machine.wait_for(ended.done, "the trajectory to end")
    finally:
        for word in ("group/disable_motion", "group/power_off"):
            assert machine.call(GroupCommand, f"/mcs/{word}", **owner).success
        assert machine.call(ReserveGroup, "/mcs/release", **owner).success
        client.destroy()
        after = machine.message(JointState, "/joint_states")
        assert machine.execute("home", group="right")().success
    answer = ended.result()
    assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0), answer.result.error_string
    moved = dict(zip(after.name, after.position, strict=True))
    assert moved["right_j4"] - arm["right_j4"] == near(0.1, 2e-3)
    assert other().success


def wrist(machine, group):
    """Position [m] and rotation of a wrist."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from im_msgs.srv import GetGroupState

    pose = machine.call(GetGroupState, "/mcs/get_group_state", group=group).state.wrist
    p, o = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z]), Rotation.from_quat([o.x, o.y, o.z, o.w])


def test_commands_with_nothing_in_common_run_at_once_and_one_that_needs_what_is_held_waits(machine):
    """The first is held where it plans its way, so that nothing depends on who is faster."""
    from im_msgs.srv import ControlNet, ListCommands

    def plans(request):
        service, net = "/path_planning_coordinator/control_net", "path_planning_coordinator"
        assert machine.call(ControlNet, service, net=net, request=request).success

    def listed():
        return {each.symbol: each for each in machine.call(ListCommands, "/dispatcher/list_commands").commands}

    assert machine.execute("home", group="left")().success
    place, turn = wrist(machine, "left")
    plans("pause")
    try:
        first = machine.execute("move", group="left", frame="tool", position=[0.0, 0.0, -0.05])
        machine.wait_for(lambda: [each.state for each in listed().values()] == ["running"], "the move to begin")
        second = machine.execute("open_gripper", group="left", width=0.06)
        beside = machine.execute("close_gripper", group="right", width=0.03)()
        under_way = listed()
        whom = f"open_gripper needs left_arm, which move (number {under_way['move'].command_id}) has"
        machine.wait_for(lambda: ("waiting", whom) in {(t.state, t.message) for t in second.told}, "whom it waits for")
    finally:
        plans("resume")
    assert beside.success, beside.status.message
    assert json.loads(beside.results) == {"width": near(0.03, 2e-3), "force": near(0.0, 1.0), "gripped": False}
    assert {name: each.state for name, each in under_way.items()} == {"move": "running", "open_gripper": "waiting"}
    assert under_way["open_gripper"].message == whom
    moved, opened = first(), second()
    assert moved.success, moved.status.message
    assert json.loads(opened.results)["width"] == near(0.06, 2e-3)
    there, turned = wrist(machine, "left")
    assert there == near(place + turn.apply([0.0, 0.0, -0.05]), 1e-3)
    assert (turn.inv() * turned).magnitude() == near(0.0, 1e-2)


def test_a_gripper_closes_from_cold_until_it_holds_what_is_between_its_jaws(machine):
    from im_msgs.srv import PutInJaws

    force, stiffness = 40.0, 1e4

    def put(width):
        thing = {"gripper": "right_gripper", "width": width, "stiffness": stiffness, "mass": 0.2}
        answer = machine.call(PutInJaws, "/testbed/put_in_jaws", **thing)
        assert answer.success, answer.message

    assert machine.execute("open_gripper", group="right")().success
    put(0.05)
    try:
        around = machine.execute("close_gripper", group="right", force=force)()
        assert around.success, around.status.message
        squeezed = near(0.05 - force / stiffness, 1e-3)
        assert json.loads(around.results) == {"width": squeezed, "force": near(force, 4.0), "gripped": True}
    finally:
        put(0.0)
    empty = machine.execute("close_gripper", group="right", width=0.03)()
    assert json.loads(empty.results) == {"width": near(0.03, 2e-3), "force": near(0.0, 1.0), "gripped": False}


def test_arguments_that_a_schema_does_not_allow_are_refused_before_anything_begins(machine):
    refused = machine.execute("open_gripper", group="right", width=0.5)()
    assert (refused.success, refused.status.code) == (False, "argument")
    assert "argument width is 0.5, not a number from 0 to 0.08 [m]" in refused.status.message
    away = machine.execute("move", group="left", position=[0.0, 0.0, 9.0])()
    assert (away.success, away.status.code) == (False, "unreachable")
    assert "the tool of left cannot be at (0, 0, 9) m in world" in away.status.message
    assert machine.execute("home", group="left")().success
    assert machine.execute("open_gripper", group="right")().success


def near(value, tolerance):
    return pytest.approx(value, abs=tolerance)


def test_a_command_survives_the_death_of_the_coordination_level_and_its_client_is_told(machine, few_poses):
    """Dispatcher, coordinators, DOM and display share a process, and go on together by their journals."""
    machine.all_ready()
    done = []
    thread = threading.Thread(
        target=lambda: done.append(run_script("calibrate_camera", "--poses", few_poses, "--json")), daemon=True
    )
    thread.start()
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    machine.kill("dispatcher")()
    machine.wait_for(lambda: machine.tasks["dispatcher"].phase == "ready", "the dispatcher")
    assert "already running" in refusal(machine, few_poses)
    thread.join(COMMAND_S)
    assert done, "the client did not end"
    assert done[0].returncode == 0, done[0].stderr
    assert "the dispatcher died and is back; attaching to number" in done[0].stderr
    report = json.loads(done[0].stdout)
    assert report["points_used"] + len(report["points_rejected"]) == FEW
    folder = Path(os.environ["IM_RESULTS_DIR"]) / "latest"
    assert json.loads((folder / "report.json").read_text()) == report
    assert list(folder.glob("*.png"))


def refusal(machine, poses):
    """What the dispatcher answers to a command now; a request that meets the one of the former life is made again."""
    from im_core.errors import WaitTimeoutError
    from im_msgs.srv import CalibrateCamera

    for _ in range(10):
        with contextlib.suppress(WaitTimeoutError):
            return machine.call(CalibrateCamera, "/dispatcher/calibrate_camera", 6.0, poses_file=str(poses)).message
    return pytest.fail("the dispatcher did not answer")


def test_whatever_arrives_nothing_dies_and_the_command_goes_on(machine, tmp_path):
    """Every interface gets values made from its type, from a process of its own, while a command runs."""
    from sensor_msgs.msg import JointState

    restarts = {name: task.restarts for name, task in machine.tasks.items()}
    thread, answers = machine.in_background(write_few_poses(tmp_path, 14))
    machine.wait_for_firing("calibrate_camera", "move_robot")
    command = [sys.executable, "-m", "bench.fuzz", "--rounds", "3", "--seed", str(SEED)]
    thrown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    assert thrown.returncode == 0, thrown.stdout + thrown.stderr[-2000:]
    told = json.loads(thrown.stdout)
    assert told["unanswered"] == told["restarted"] == []
    assert all(told["interfaces"][kind] >= few for kind, few in (("topic", 20), ("service", 100), ("action", 11)))
    assert all(count > 0 for count in told["sent"].values())
    assert max(told["grown"].values()) < MOST_GROWTH_MIB, told["grown"]
    thread.join(COMMAND_S)
    (answer,) = answers
    assert answer.success, answer.message
    assert {name: task.restarts for name, task in machine.tasks.items()} == restarts
    positions = []
    machine.node.create_subscription(JointState, "/joint_states", positions.append, 10)
    machine.wait_for(lambda: positions, "the joints")
    joints = dict(zip(positions[-1].name, positions[-1].position, strict=True))
    home = dict(zip(load_cell().joint_names, load_cell().home, strict=True))
    right = [name for name in home if name.startswith("right")]
    assert [joints[name] for name in right] == pytest.approx([home[name] for name in right], abs=0.01)


def test_a_keystore_lets_each_process_do_what_it_does_and_nothing_else(machine, tmp_path):
    command = [ROOT / "scripts" / "im", "security", "make", tmp_path / "keystore"]
    made = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    assert made.returncode == 0, made.stderr

    def permissions(enclave):
        return tmp_path / "keystore" / "enclaves" / "im" / enclave / "permissions.xml"

    def may_publish(enclave):
        rule = ElementTree.parse(permissions(enclave)).find("permissions/grant/allow_rule/publish/topics")
        return {topic.text for topic in rule}

    processes = {f"{task.host}/{task.process}" for task in machine.tasks.values()}
    assert processes | {"localhost/bootstrap", "client"} == {
        str(path.parent.relative_to(tmp_path / "keystore" / "enclaves" / "im"))
        for path in (tmp_path / "keystore" / "enclaves").rglob("permissions.xml")
    }
    owned = {
        "rt/joint_states": "localhost/mcs",
        "rr/mcs/estopReply": "localhost/mcs",
        "rr/dispatcher/execute/_action/send_goalReply": f"localhost/{machine.tasks['dispatcher'].process}",
        "rt/bootstrap/tasks": "localhost/bootstrap",
    }
    for topic, owner in owned.items():
        assert {each for each in (*processes, "localhost/bootstrap", "client") if topic in may_publish(each)} == {owner}
    assert "rt/left/joint_trajectory" in may_publish("client")
    assert "rt/im/task_status" not in may_publish("client")
    refused = {end for end in ends(machine) if not allowed(permissions(end[0]), *end[1:])}
    assert refused <= {("client", "publish", "rt/im/task_status")}  # of nodes of tests that are tasks


def ends(machine):
    """Every end in the graph: enclave without ``/im/``, way, topic of DDS."""
    node = machine.node
    ways = {"publish": node.get_publishers_info_by_topic, "subscribe": node.get_subscriptions_info_by_topic}
    enclaves = {task.node: f"{task.host}/{task.process}" for task in machine.tasks.values()}
    enclaves["/bootstrap"] = "localhost/bootstrap"
    of_participant = {
        bytes(end.endpoint_gid)[:12]: enclaves[name]
        for end in ways["publish"]("/rosout")
        if (name := f"/{end.node_name}") in enclaves
    }
    assert set(of_participant.values()) == set(enclaves.values())
    for topic, _ in node.get_topic_names_and_types(no_demangle=True):
        for way, ask in ways.items():
            for end in ask(topic, no_mangle=True):
                yield of_participant.get(bytes(end.endpoint_gid)[:12], "client"), way, topic


@pytest.fixture
def odd_poses(few_poses, tmp_path):
    """A file of few poses, and of one that is out of reach and one out of sight."""
    poses = yaml.safe_load(few_poses.read_text())
    half = math.sqrt(0.5)
    moon = {"name": "moon", "position_m": [0.0, 0.0, 9.0], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    down = {"name": "down", "position_m": [-0.3, 0.2, 1.2], "orientation_xyzw": [-half, 0.0, 0.0, half]}
    first, second, *others = poses["poses"]
    poses["poses"] = [first, moon, second, down, *others]
    poses["order"] = "given"
    path = tmp_path / "odd.yaml"
    path.write_text(yaml.safe_dump(poses))
    return path


def test_who_changes_the_net_changes_what_happens(machine, few_poses, odd_poses):
    """Without the transition light_on the light stays off, and no spot is found: there is no sequence in Python.

    With it again a command runs as before, and a second one is refused meanwhile; it skips and reports poses that are
    out of reach or out of sight.
    """
    from im_msgs.srv import LoadNet

    file = package_file("im_dispatcher", "nets/calibrate_camera.yaml")
    written = file.read_text()
    net = json.loads(json.dumps(describe(load_net(file))))
    del net["transitions"]["cell.light_on"]
    del net["transitions"]["cell.leave_light"]["guard"]  # as for a board
    assert machine.call(LoadNet, "/dispatcher/load_net", net_yaml=yaml.safe_dump(net)).success
    dark = machine.calibrate(few_poses)
    assert not dark.success
    assert "light left_led is off" in dark.message
    assert machine.call(LoadNet, "/dispatcher/load_net", net_yaml=written).success
    thread, answers = machine.in_background(odd_poses)
    machine.wait_for_firing("calibrate_camera", "move_robot")
    second = machine.calibrate(few_poses)
    assert not second.success
    assert "already running" in second.message
    thread.join(COMMAND_S)
    assert answers[0].success, answers[0].message
    rejected = {entry["pose"]: entry["reason"] for entry in report_of(answers[0])["points_rejected"]}
    assert "out of reach" in rejected["moon"]
    assert "no camera sees the light" in rejected["down"]


def test_a_net_that_can_get_stuck_is_refused_with_the_way_there(machine):
    from im_msgs.srv import LoadNet

    net = yaml.safe_load(package_file("im_dispatcher", "nets/calibrate_camera.yaml").read_text())
    del net["transitions"]["acknowledge"]
    refused = machine.call(LoadNet, "/dispatcher/load_net", net_yaml=yaml.safe_dump(net, sort_keys=False))
    assert not refused.success
    assert any("power_down" in step for step in refused.counterexample)


def test_the_same_seed_gives_the_same_run(first_run, few_poses, tmp_path, other_domain):
    """A second machine on this host, in a ROS domain of its own, beside the first; its tasks share no process."""
    other = {
        "ROS_DOMAIN_ID": str(other_domain),
        "IM_RUN_DIR": str(tmp_path / "run"),
        "IM_RESULTS_DIR": str(tmp_path / "results"),
    }
    started = run_script("start", EACH, "--factor", 0, "--seed", SEED, "--port", free_port(), **other)
    assert started.returncode == 0, started.stdout + started.stderr
    try:
        done = run_script("calibrate_camera", "--poses", few_poses, "--json", **other)
    finally:
        ended = run_script("stop", **other)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ended.returncode == 0, ended.stdout + ended.stderr
    second = json.loads((tmp_path / "results" / "latest" / "report.json").read_text())
    first = report_of(first_run[0])
    for report in (first, second):
        del report["timing"]
    assert_equal(first, second, "report")


def assert_equal(first, second, where):
    assert type(first) is type(second), where
    if isinstance(first, dict):
        assert first.keys() == second.keys(), where
        for key in first:
            assert_equal(first[key], second[key], f"{where}.{key}")
    elif isinstance(first, list):
        assert len(first) == len(second), where
        for index, pair in enumerate(zip(first, second, strict=True)):
            assert_equal(*pair, f"{where}[{index}]")
    elif isinstance(first, float):
        assert math.isclose(first, second, rel_tol=1e-6, abs_tol=1e-6), f"{where}: {first} and {second}"
    else:
        assert first == second, where
