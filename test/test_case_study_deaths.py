"""The case study on a machine of which every task has a process, and processes die: a command survives or says why."""

import os
import signal
from pathlib import Path

import pytest

from support.whole_machine import COMMAND_S, EACH, report_of, run_script, running_machine, write_few_poses

pytestmark = pytest.mark.end_to_end

POSES = 14
READY_AGAIN = "recover: ready: 10 tasks, MCS is cold"


@pytest.fixture(scope="module")
def few_poses(tmp_path_factory):
    return write_few_poses(tmp_path_factory.mktemp("poses"), POSES)


@pytest.fixture(scope="module")
def machine():
    with running_machine(EACH) as machine:
        yield machine


def test_without_a_configured_mcs_the_command_says_so(machine, few_poses):
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


def test_one_command_brings_the_machine_back_after_the_death_of_testbed_and_servo(machine):
    """The commands of the tests that follow find it as it was."""
    from im_core.ros import qos
    from im_msgs.msg import McsState
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
    # a command that begins before may end with it as its reason
    told = lambda: machine.message(McsState, "/mcs/state", profile=qos.LATCHED).state  # noqa: E731
    machine.wait_for(lambda: told() == "unconfigured", "MCS to notice")
    homed = machine.execute("home", group="left")()  # a command brings it back by itself
    assert homed.success, homed.status.message


def child_of(module):
    """Process id of the machine's process that runs a module."""
    from im_bringup.machine import leftovers

    for process in leftovers.processes():
        if module.encode() in Path(f"/proc/{process.pid}/cmdline").read_bytes().split(b"\0"):
            return process.pid
    raise AssertionError(f"no process runs {module}")


def test_a_killed_mcs_is_named_and_comes_back(machine, few_poses):
    """The command of the test that follows succeeds."""
    machine.all_ready()
    thread, answers = machine.in_background(few_poses)
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    back = machine.kill("mcs")
    thread.join(COMMAND_S)
    assert answers, "the command did not end"
    assert not answers[0].success
    assert "mcs" in answers[0].message
    back()


def test_a_command_survives_the_deaths_of_coordinators(machine, few_poses):
    """What is journalled goes on; each pose is visited once, and a pose is lost only for what the cameras saw."""
    machine.all_ready()
    thread, answers = machine.in_background(few_poses)
    for victim in ("vision_coordinator", "motion_coordinator", "path_planning_coordinator", "dom"):
        machine.wait_for_firing("motion_coordinator", "move_manip", 3)
        machine.kill(victim)()
    thread.join(COMMAND_S)
    assert answers, "the command did not end"
    assert answers[0].success, answers[0].message
    report = report_of(answers[0])
    assert report["points_used"] + len(report["points_rejected"]) == POSES
    assert report["points_used"] >= POSES - 4


def test_the_calibration_in_use_outlives_vss(machine):
    from sensor_msgs.srv import SetCameraInfo

    from im_msgs.srv import Snap

    machine.all_ready()

    def seen():
        answer = machine.call(Snap, "/vss/snap", cameras=["wall"])
        assert answer.success, answer.status.message
        return answer.camera_infos[0]

    info = seen()
    info.k, info.d = [701.0, 0.0, 320.0, 0.0, 702.0, 240.0, 0.0, 0.0, 1.0], [0.0] * 5
    info.distortion_model = "plumb_bob"
    answer = machine.call(SetCameraInfo, "/wall/set_camera_info", camera_info=info)
    assert answer.success, answer.status_message
    machine.kill("vss")()
    assert list(seen().k) == list(info.k)


def test_an_estop_ends_the_command_with_its_reason_and_reset_mends_it(machine, few_poses):
    thread, answers = machine.in_background(few_poses)
    machine.wait_for_firing("motion_coordinator", "move_manip", 3)
    assert machine.trigger("/mcs/estop").success
    thread.join(COMMAND_S)
    assert answers, "the command did not end"
    assert not answers[0].success
    assert "stop" in answers[0].message.lower()
    machine.kill("mcs")()  # a stop that was asked for outlives who was asked
    refused = machine.calibrate(few_poses)
    assert not refused.success
    assert "reset" in refused.message
    assert machine.trigger("/mcs/reset").success
    again = machine.execute("home", group="left")()
    assert again.success, again.status.message
