"""The client ``im`` and its examples, on a whole machine."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from std_msgs.msg import String

from im import CommandCancelledError, Machine, MachineError, Pose, UnreachableError
from support.notebook import source_of
from support.whole_machine import COMMAND_S, SEED, free_port, run_script, write_few_poses

pytestmark = pytest.mark.end_to_end

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
#: A line of what each example prints.
SAYS = {
    "hello.py": "home: Moves an arm home",
    "calibrate.py": "pictures and camera files: ",
    "move_arm.py": "gripper open by 80 mm",
    "look.py": "not_found: ceiling_left sees no spot",
    "own_net.py": "fired: ",
    "two_at_once.py": "home: <command ",
}


@pytest.fixture(scope="module")
def machine():
    """A machine that is started for a program, and stopped at its end."""
    with pytest.raises(MachineError, match="clock_factor: -1"):
        Machine.start(factor=-1)
    with Machine.start(factor=0, seed=SEED, fresh=True, port=free_port()) as im:
        yield im
    with pytest.raises(UnreachableError, match="no machine runs in ROS domain"):
        Machine.connect(timeout=3.0)


@pytest.fixture
def im(machine):
    with Machine.connect(timeout=60.0) as im:
        yield im


def test_all_examples_are_tried():
    """That of the second mission needs free bodies: ``test_moved_camera.py``."""
    assert {*SAYS, "handover.py"} == {path.name for path in EXAMPLES.glob("*.py")}


@pytest.mark.parametrize("name", SAYS)
def test_examples_run(machine, name, tmp_path):
    arguments = [write_few_poses(tmp_path)] if name == "calibrate.py" else []
    argv = [sys.executable, EXAMPLES / name, *arguments]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert SAYS[name] in done.stdout


def test_the_notebook_of_the_machine_runs_from_its_first_cell_to_its_last(machine):
    argv = [sys.executable, "-c", source_of(EXAMPLES / "see_and_move.ipynb")]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the light has moved by" in done.stdout


def test_an_arm_is_reserved_moved_and_given_back(im):
    with im.left.reserved(lease=30.0) as arm:
        owner = {group.group: group.owner for group in im.state.groups}["left"]
        assert owner == im.connection.name
        with Machine.connect(timeout=60.0) as other, pytest.raises(MachineError, match=owner), other.left.reserved():
            pytest.fail("the group is another client's")
        start = arm.tool_pose
        arm.move_joints(left_j6=0.2)
        assert arm.joints["left_j6"] == pytest.approx(0.2, abs=1e-3)
        lower = start.position - np.array([0.0, 0.0, 0.03])
        arm.move_to(Pose(lower), straight=True)
        np.testing.assert_allclose(arm.tool_pose.position, lower, atol=1e-3)
        with pytest.raises(MachineError, match="out of reach"):
            arm.move_to(Pose([9.0, 9.0, 9.0]))
        for given in ({"pose": [0.3, 0.0, 1.0]}, {"pose": arm.tool_pose, "via": (0.3, 0.0, 1.0)}):
            with pytest.raises(TypeError, match=r"is .0\.3, 0\.0, 1\.0.; a Pose is needed, such as Pose\("):
                arm.move_to(**given)
        with pytest.raises(MachineError, match="group left has no joint left_j7; there are left_track"):
            arm.move_joints(left_j7=0.0)
        with pytest.raises(MachineError, match="move_joints of group left needs a position of one of left_track"):
            arm.move_joints()
    assert im.state.state == "cold"


def test_what_fails_inside_gives_the_arm_back_and_says_why(im):
    def stopped():
        with im.left.reserved() as arm:
            im.estop()
            arm.move_joints(left_j6=0.0)

    with pytest.raises(MachineError, match="estop"):
        stopped()
    assert im.state.state == "estopped"
    im.reset()
    with im.left.reserved() as arm:
        arm.move_joints(left_j6=0.0)


def test_commands_are_paused_cancelled_attached_to_and_refused(im):
    command = im.run("demo", wait=False)
    command.pause()
    assert [state.symbol for state in im.under_way] == ["demo"]
    other = im.attach(command.number)
    command.cancel()
    for each in (command, other):
        with pytest.raises(CommandCancelledError):
            _ = each.result
    with pytest.raises(MachineError, match="there is no command 'dance'"):
        im.run("dance")


def test_a_command_that_is_held_is_abandoned_from_a_shell_and_the_next_one_has_the_arms(im):
    command = im.run("demo", wait=False)
    command.pause()
    done = run_script("im", "run", "--abandon", str(command.number), "--yes", timeout=COMMAND_S)
    assert f"abandon demo (number {command.number}): abandoned by the operator; it held: " in done.stdout
    with pytest.raises(MachineError, match=r"abandoned by the operator; it held: ") as ended:
        _ = command.result
    assert ended.value.code == "abandoned"
    assert not im.under_way
    im.run("home")


def test_images_spots_and_data_objects(im):
    image = im.camera("wall").snap()
    assert (image.ndim, image.dtype, image.std() > 0.0) == (2, np.uint8, True)
    assert image._repr_png_().startswith(b"\x89PNG")
    im.dom["client/greeting"] = String(data="hello")
    assert "client/greeting" in im.dom
    assert im.dom["client/greeting"].data == "hello"
    im.dom.invalidate("client/greeting")
    assert "client/greeting" not in im.dom
    with pytest.raises(MachineError, match="there is no data object 'none'"):
        _ = im.dom["none"]
    for thing in (5, "hello", String):
        with pytest.raises(MachineError, match="is no ROS message, as "):
            im.dom["client/greeting"] = thing


def test_a_refused_net_tells_the_firings_that_show_why(im):
    net = "net: stuck\ncommands: {stuck: {}}\nplaces: {a: 1, b: }\ntransitions: {t: {symbol: stuck, in: a, out: b}}\n"
    with pytest.raises(MachineError) as refused:
        im.load_net(net)
    assert refused.value.message


def test_a_bag_is_recorded(im, tmp_path):
    with im.record(tmp_path / "bag"):
        im.run("home")
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    with pytest.raises(MachineError, match="cannot be made: File exists"), im.record(tmp_path / "bag"):
        pytest.fail("goes on without a recorder")


def test_a_machine_that_is_closed_says_so(im):
    other = Machine.connect()
    assert other.state.groups
    other.run("home")
    other.close()
    for ask in (lambda: other.run("home"), lambda: other.state, lambda: other.under_way, lambda: other.dom["a"]):
        with pytest.raises(MachineError, match="the connection is closed"):
            ask()
