"""The case study of the paper, section 7, on the whole machine: through every level, and what can go wrong."""

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import yaml

from im_cell.calibration_files import read_calibration
from im_cell.robot import load_cell
from im_core import clock
from im_core.config import package_file

pytestmark = pytest.mark.end_to_end
ROOT = Path(__file__).resolve().parent.parent

SEED = 3
FEW = 20
COMMAND_S = 240.0
MOST_GROWTH_MIB = 200.0
READY_AGAIN = "recover: ready: 10 tasks, MCS is cold"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def few_poses(tmp_path_factory):
    """Half of the cell's own poses."""
    own = yaml.safe_load(package_file("im_dispatcher", "poses/ceiling_40.yaml").read_text())
    own["poses"] = own["poses"][::2]
    assert len(own["poses"]) == FEW
    path = tmp_path_factory.mktemp("poses") / "few.yaml"
    path.write_text(yaml.safe_dump(own))
    return path


class Machine:
    """A running machine and a node that talks to it."""

    def __init__(self, run_script):
        import rclpy

        from im_core.ros import qos
        from im_core.ros.node import ManagedNode
        from im_core.ros.run import spin_in_thread
        from im_msgs.msg import Firing, TaskRegistry

        self.run_script = run_script
        rclpy.init(args=[])
        self.node = ManagedNode("case_study_test")
        self.firings = []
        self.tasks = {}
        self.node.create_subscription(Firing, "/pnt/firings", self.firings.append, qos.EVENTS)
        self.node.create_subscription(TaskRegistry, "/bootstrap/tasks", self._registry, qos.LATCHED)
        self.spinner = spin_in_thread(self.node)

    def _registry(self, message):
        self.tasks = {task.name: task for task in message.tasks}

    def call(self, kind, name, timeout=60.0, **fields):
        from im_core.ros.calls import call_blocking

        client = self.node.create_client(kind, name)
        try:
            return call_blocking(client, kind.Request(**fields), timeout, f"{name} of the test")
        finally:
            self.node.destroy_client(client)

    def calibrate(self, poses="", cameras=()):
        from im_msgs.srv import CalibrateCamera

        return self.call(
            CalibrateCamera,
            "/dispatcher/calibrate_camera",
            COMMAND_S,
            cameras=list(cameras),
            poses_file=str(poses),
        )

    def trigger(self, name):
        from std_srvs.srv import Trigger

        return self.call(Trigger, name)

    def in_background(self, poses):
        answers = []
        thread = threading.Thread(target=lambda: answers.append(self.calibrate(poses)), daemon=True)
        thread.start()
        return thread, answers

    def wait_for(self, condition, what, seconds=60.0):
        deadline = clock.monotonic() + seconds
        while not condition():
            assert clock.monotonic() < deadline, f"waited {seconds} s for {what}, in vain"
            clock.sleep(0.02)

    def wait_for_firing(self, net, transition, count=1):
        begin = len(self.firings)

        def seen():
            fired = [f for f in self.firings[begin:] if (f.net, f.transition) == (net, transition)]
            return len(fired) >= count

        self.wait_for(seen, f"{count} firings of {net}.{transition}")

    def message(self, kind, topic, seconds=60.0, profile=None):
        from im_core.ros import qos

        received = []
        subscription = self.node.create_subscription(kind, topic, received.append, profile or qos.EVENTS)
        self.wait_for(lambda: received, topic, seconds)
        self.node.destroy_subscription(subscription)
        return received[0]

    def stop(self):
        import rclpy

        self.spinner.stop()
        rclpy.try_shutdown()
        return self.run_script("stop")


@pytest.fixture(scope="module")
def run_script():
    import subprocess

    root = Path(__file__).resolve().parent.parent

    def run(name, *arguments, timeout=300.0, **environment):
        return subprocess.run(
            ["bash", str(root / "scripts" / f"{name}.sh"), *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout,
            env={**os.environ, **environment},
            check=False,
        )

    return run


@pytest.fixture(scope="module")
def machine(run_script):
    started = run_script("start", "--factor", 0, "--seed", SEED, "--port", free_port())
    assert started.returncode == 0, started.stdout + started.stderr
    machine = Machine(run_script)
    yield machine
    ended = machine.stop()
    assert ended.returncode == 0, ended.stdout + ended.stderr


@pytest.fixture(scope="module")
def first_run(machine, few_poses):
    """The answer to the first command of the machine, and the firings that led to it."""
    begin = len(machine.firings)
    answer = machine.calibrate(few_poses)
    clock.sleep(0.5)
    return answer, machine.firings[begin:]


def report_of(answer):
    return json.loads((Path(answer.report.directory) / "report.json").read_text())


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
    assert report["points_used"] >= 12
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
    assert ended.count(("calibrate_camera", "read_next_pos")) == FEW
    assert ended.count(("motion_coordinator", "move_manip")) == FEW
    assert ended.count(("calibrate_camera", "loop_done")) + ended.count(("calibrate_camera", "skip_done")) == 1
    assert ended.count(("motion_coordinator", "validate_path")) == 0
    order = [ended.index(("calibrate_camera", name)) for name in ("init_calib", "power_up", "move_robot", "find_spot")]
    assert order == sorted(order)
    for net in {f.net for f in firings}:
        numbers = [f.sequence for f in firings if f.net == net]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), f"firings of {net} were lost"


def test_calibration_reaches_the_standard_interfaces(first_run, machine):
    from sensor_msgs.msg import CameraInfo
    from tf2_msgs.msg import TFMessage

    from im_core.ros import qos
    from im_msgs.srv import Snap

    answer, _ = first_run
    thread = threading.Timer(0.5, lambda: machine.call(Snap, "/vss/snap", cameras=["ceiling_left"]))
    thread.start()
    info = machine.message(CameraInfo, "/ceiling_left/camera_info")
    thread.join()
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
    assert len(state.name) == len(state.position) == 18
    services = dict(machine.node.get_service_names_and_types())
    assert services["/mcs/estop"] == ["std_srvs/srv/Trigger"]
    assert services["/dispatcher/calibrate_camera"] == ["im_msgs/srv/CalibrateCamera"]
    assert services["/mcs/change_state"] == ["lifecycle_msgs/srv/ChangeState"]
    assert services["/wall/set_camera_info"] == ["sensor_msgs/srv/SetCameraInfo"]


def test_the_page_of_interfaces_is_what_the_machine_offers(machine, run_script):
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


def test_poses_out_of_reach_or_out_of_sight_are_skipped_and_reported(machine, few_poses, tmp_path):
    poses = yaml.safe_load(few_poses.read_text())
    half = math.sqrt(0.5)
    poses["poses"][1] = {"name": "moon", "position_m": [0.0, 0.0, 9.0], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    poses["poses"][3] = {"name": "down", "position_m": [-0.3, 0.2, 1.2], "orientation_xyzw": [-half, 0.0, 0.0, half]}
    path = tmp_path / "odd.yaml"
    path.write_text(yaml.safe_dump(poses))
    answer = machine.calibrate(path)
    assert answer.success, answer.message
    rejected = {entry["pose"]: entry["reason"] for entry in report_of(answer)["points_rejected"]}
    assert "out of reach" in rejected["moon"]
    assert "no camera sees the light" in rejected["down"]


def test_without_a_configured_mcs_the_command_says_so(machine, few_poses, run_script):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    def change(transition):
        request = {"transition": Transition(id=transition)}
        assert machine.call(ChangeState, "/mcs/change_state", **request).success

    change(Transition.TRANSITION_CLEANUP)
    answer = machine.calibrate(few_poses)
    recovered = run_script("run", "im_bringup", "recover")
    assert not answer.success
    assert "MCS is unconfigured; scripts/im recover configures it" in answer.message
    assert (recovered.returncode, "MCS is unconfigured; configure" in recovered.stdout) == (0, True), recovered.stderr


def test_one_command_brings_the_machine_back_after_the_death_of_testbed_and_servo(machine, few_poses, run_script):
    """The commands of the tests that follow find it as it was."""
    from im_msgs.srv import ReserveGroup

    assert machine.call(ReserveGroup, "/mcs/reserve", group="left").success
    for name in ("power_on", "enable_motion"):
        assert machine.trigger(f"/mcs/{name}").success
    before = machine.tasks["testbed"]
    os.kill(child_of("im_sim.physics"), signal.SIGKILL)
    machine.wait_for(lambda: machine.tasks["testbed"].restarts > before.restarts, "the testbed to be started again")
    recovered = run_script("run", "im_bringup", "recover")
    assert (recovered.returncode, recovered.stdout.splitlines()[-1]) == (0, READY_AGAIN), recovered.stderr
    assert "MCS is estopped: the testbed's physics process is gone; reset" in recovered.stdout
    os.kill(child_of("im_mcs.servo"), signal.SIGKILL)
    answer = machine.calibrate(few_poses)  # a command brings it back by itself
    assert answer.success, answer.message


def child_of(module):
    """Process id of the machine's process that runs a module."""
    from im_bringup.machine import leftovers

    for process in leftovers.processes():
        if module.encode() in Path(f"/proc/{process.pid}/cmdline").read_bytes().split(b"\0"):
            return process.pid
    raise AssertionError(f"no process runs {module}")


def test_a_second_command_is_refused_while_one_runs(machine, few_poses):
    thread, answers = machine.in_background(few_poses)
    machine.wait_for_firing("calibrate_camera", "move_robot")
    second = machine.calibrate(few_poses)
    assert not second.success
    assert "already running" in second.message
    thread.join(COMMAND_S)
    assert answers[0].success, answers[0].message


def test_an_estop_ends_the_command_with_its_reason_and_reset_mends_it(machine, few_poses):
    thread, answers = machine.in_background(few_poses)
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    assert machine.trigger("/mcs/estop").success
    thread.join(60.0)
    assert answers, "the command did not end"
    assert not answers[0].success
    assert "stop" in answers[0].message.lower()
    refused = machine.calibrate(few_poses)
    assert not refused.success
    assert "reset" in refused.message
    assert machine.trigger("/mcs/reset").success
    again = machine.calibrate(few_poses)
    assert again.success, again.message


def kill(machine, victim):
    """Kills a task; returns when the one that takes its place is ready."""
    before = machine.tasks[victim].incarnation
    os.kill(machine.tasks[victim].pid, signal.SIGKILL)
    return lambda: machine.wait_for(
        lambda: machine.tasks[victim].incarnation != before and machine.tasks[victim].phase == "ready",
        f"{victim} to come back",
        40.0,
    )


@pytest.mark.parametrize("victim", ["vision_coordinator", "motion_coordinator", "path_planning_coordinator", "dom"])
def test_a_command_survives_the_death_of_a_coordinator(machine, few_poses, victim):
    """What is journalled goes on; each pose is visited once, and a pose is lost only for what the cameras saw."""
    machine.wait_for(lambda: machine.tasks and all(t.phase == "ready" for t in machine.tasks.values()), "all tasks")
    thread, answers = machine.in_background(few_poses)
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    back = kill(machine, victim)
    thread.join(COMMAND_S)
    assert answers, "the command did not end"
    assert answers[0].success, answers[0].message
    report = report_of(answers[0])
    assert report["points_used"] + len(report["points_rejected"]) == FEW
    assert report["points_used"] >= FEW - 3
    back()


def test_a_command_survives_the_death_of_the_dispatcher_and_its_client_is_told(machine, few_poses, run_script):
    machine.wait_for(lambda: all(t.phase == "ready" for t in machine.tasks.values()), "all tasks")
    done = []
    thread = threading.Thread(
        target=lambda: done.append(run_script("calibrate_camera", "--poses", few_poses, "--json")), daemon=True
    )
    thread.start()
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    kill(machine, "dispatcher")()
    machine.wait_for(lambda: machine.tasks["dispatcher"].phase == "ready", "the dispatcher")
    assert "already running" in refusal(machine, few_poses)
    thread.join(COMMAND_S)
    assert done, "the client did not end"
    assert done[0].returncode == 0, done[0].stderr
    assert "the dispatcher died and is back" in done[0].stderr
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


def test_a_killed_mcs_is_named_and_comes_back(machine, few_poses):
    machine.wait_for(lambda: all(t.phase == "ready" for t in machine.tasks.values()), "all tasks")
    thread, answers = machine.in_background(few_poses)
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    back = kill(machine, "mcs")
    thread.join(60.0)
    assert answers, "the command did not end"
    assert not answers[0].success
    assert "mcs" in answers[0].message
    back()
    again = machine.calibrate(few_poses)
    assert again.success, again.message


def test_whatever_arrives_nothing_dies_and_the_command_goes_on(machine, few_poses):
    """Every interface gets values made from its type, from a process of its own, while a command runs."""
    from sensor_msgs.msg import JointState

    restarts = {name: task.restarts for name, task in machine.tasks.items()}
    thread, answers = machine.in_background(few_poses)
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
    right = [name for name in joints if name.startswith("right")]
    assert right
    assert [joints[name] for name in right] == pytest.approx([home[name] for name in right], abs=0.01)


def test_who_changes_the_net_changes_what_happens(machine, few_poses):
    """Without the transition light_on the light stays off, and no spot is found: there is no sequence in Python."""
    from im_msgs.srv import LoadNet

    written = package_file("im_dispatcher", "nets/calibrate_camera.yaml").read_text()
    net = yaml.safe_load(written)
    del net["transitions"]["light_on"]
    net["transitions"]["init_calib"]["out"] = ["light_ready"]
    del net["places"]["job_read"]
    assert machine.call(LoadNet, "/dispatcher/load_net", net_yaml=yaml.safe_dump(net)).success
    dark = machine.calibrate(few_poses)
    assert not dark.success
    assert "no light seen" in dark.message
    assert machine.call(LoadNet, "/dispatcher/load_net", net_yaml=written).success
    bright = machine.calibrate(few_poses)
    assert bright.success, bright.message


def test_a_net_that_can_get_stuck_is_refused_with_the_way_there(machine):
    from im_msgs.srv import LoadNet

    net = yaml.safe_load(package_file("im_dispatcher", "nets/calibrate_camera.yaml").read_text())
    del net["transitions"]["acknowledge"]
    refused = machine.call(LoadNet, "/dispatcher/load_net", net_yaml=yaml.safe_dump(net, sort_keys=False))
    assert not refused.success
    assert any("power_down" in step for step in refused.counterexample)


def test_the_same_seed_gives_the_same_run(first_run, run_script, few_poses, tmp_path):
    """A second machine on this host, in a ROS domain of its own, beside the first."""
    other = {
        "ROS_DOMAIN_ID": str(int(os.environ["ROS_DOMAIN_ID"]) + 100),
        "IM_RUN_DIR": str(tmp_path / "run"),
        "IM_RESULTS_DIR": str(tmp_path / "results"),
    }
    started = run_script("start", "--factor", 0, "--seed", SEED, "--port", free_port(), **other)
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
