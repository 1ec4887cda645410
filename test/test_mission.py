"""A command outlives its machine: everything is killed in the middle of it, and whoever starts it again resumes it."""

import json
import subprocess
import sys

import pytest
import yaml

from bench.chaos.everything import DEVIATIONS, distance
from bench.chaos.machine import die_starting
from im_bringup.machine import leftovers, stop
from im_bringup.tasks import deployment as deployments
from im_core import clock, names, unfinished_commands
from im_core.ros import qos
from im_msgs.msg import Firing, McsState
from im_msgs.srv import ControlCommand, LoadNet
from support.mcs_config import write_mcs_config
from support.whole_machine import COMMAND_S, SEED, Machine, free_port, run_script, write_few_poses

pytestmark = pytest.mark.end_to_end

POSES = 12
CONTROL = "/dispatcher/control_command"
#: After so long a command that went on by itself would have moved an arm: it took 2 s after "ready" [s].
STILL_S = 6.0
#: Two arms under way, whoever waits for one of them, and one that is paused as it waits.
LINE = {
    "demo": {},
    "home": {"group": "left"},
    "move": {"group": "right", "joints": [1.55, 0.0, 0.0, 0.3, 1.57, -3.7, 0.0, 0.3, 0.0]},
    "close_gripper": {"group": "left", "width": 0.02},
}
GREET = """
net: greet
commands: {greet: {}}
places: {idle: {tokens: 1, resource: true}, greeted: }
transitions: {go: {symbol: greet, in: idle, out: greeted}, tell: {in: greeted, out: idle, emit: greet_done}}
"""


@pytest.fixture
def machines(tmp_path):
    """Starts machines, one after the death of the other; the last is stopped.

    In real time their servos take a busy computer that misses deadlines as it is.
    """
    config, deployment = write_mcs_config(tmp_path, servo={"max_overruns": 10_000}), tmp_path / "deployment.yaml"
    tasks = yaml.safe_load(deployments.default_path().read_text(encoding="utf-8"))
    tasks["hosts"]["localhost"]["mcs"]["mcs"]["parameters"]["config"] = str(config)
    deployment.write_text(yaml.safe_dump(tasks, sort_keys=False), encoding="utf-8")  # started in their order

    def start(*options):
        started = run_script("start", deployment, "--factor", 0, "--seed", SEED, "--port", free_port(), *options)
        assert started.returncode == 0, started.stdout + started.stderr
        return started.stdout

    yield start
    assert run_script("stop").returncode == 0


def client(module, *arguments):
    """A command of the shell that runs beside the test."""
    argv = [sys.executable, "-m", f"im_bringup.ros.{module}", *map(str, arguments)]
    return subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def resume(symbol, number):
    """Resumes a paused command as a user does."""
    said = client("run_command", "--resume", number).communicate(timeout=COMMAND_S)
    assert said == (f"resume {symbol} (number {number})\n", ""), said


def kill_everything_at(command, lines):
    """Kills all processes of the machine when a command has told so many lines of progress."""
    for _ in range(lines):
        while not (line := command.stderr.readline()).startswith("["):
            assert line, "the command ended before its machine was killed"
    _, remaining = leftovers.end_all()
    assert not remaining
    command.kill()
    command.communicate()


def test_a_calibration_goes_on_after_the_death_of_everything(machines, tmp_path):
    """It finds what is true, as an undisturbed one does; a start may be killed, too."""
    machines("--fresh")
    calibrate = ("calibrate_camera", "--json", "--poses-file", write_few_poses(tmp_path, POSES))
    kill_everything_at(client("run_command", *calibrate), 40)
    (unfinished,) = unfinished_commands.noted(names.run_dir())
    die_starting(0.0, SEED, free_port(), 4.0)
    assert unfinished_commands.noted(names.run_dir()) == [unfinished]
    assert "calibrate_camera (number 1 of dispatcher) goes on" in machines("--resume")
    ended = client("run_command", "--attach", unfinished.number, "--json")
    resumed, said = ended.communicate(timeout=COMMAND_S)
    assert ended.returncode == 0, said
    report = json.loads(resumed)["report"]
    assert report["points_used"] >= POSES - 2  # an arm that comes from elsewhere may hide the light
    assert distance(report, {"cameras": [true_camera(each) for each in report["cameras"]]}) <= DEVIATIONS


def true_camera(found):
    """A camera of a report as the testbed has it, in the form of the report."""
    true = json.loads((names.run_dir() / "truth.json").read_text())["cameras"][found["name"]]
    return {**true, "name": found["name"], "standard_deviations": dict.fromkeys(found["standard_deviations"], 0.0)}


def line_up(machine):
    """The commands of the line, all given, and their numbers."""
    machine.call(ControlCommand, CONTROL, command_id=1, request="pause")  # of nobody: the service is there
    given = {symbol: machine.execute(symbol, **arguments) for symbol, arguments in LINE.items()}
    machine.wait_for(lambda: all(command.told for command in given.values()), "the numbers of the commands")
    return given, {symbol: command.told[0].command_id for symbol, command in given.items()}


def stopped():
    """Stops the machine, which says what that interrupts, and how far it was."""
    said = []
    assert stop.stop(said.append) == 0
    assert "interrupted: demo (number" in said[0], said
    assert "the next start brings them back paused" in said[0]


def require_stillness():
    """Looks for longer than a command would have taken that went on: no action begins, no arm gets power."""
    machine, told = Machine(), []
    try:
        machine.node.create_subscription(McsState, "/mcs/state", told.append, qos.LATCHED)
        machine.wait_for(lambda: told, "the state of MCS")
        clock.sleep(STILL_S)
        assert {(state.state, state.power) for state in told} == {("cold", False)}
        assert not [firing for firing in machine.firings if firing.phase == Firing.START]
    finally:
        machine.close()


def under_way():
    """What im run lists of the commands that have not ended, by number."""
    printed = client("run_command").communicate(timeout=COMMAND_S)[0]
    return {int(line.split()[1].rstrip(":")): line for line in printed.splitlines() if line.startswith("number ")}


@pytest.mark.parametrize(("end", "starts"), [(leftovers.end_all, 2), (stopped, 1)], ids=["kill -9", "stop"])
def test_what_ran_and_what_waited_comes_back_paused_and_goes_on_when_it_is_told_to(machines, end, starts, wait_until):
    """Nothing moves because the machine was started, also once more; each goes on, or ends, as somebody says."""
    machines("--fresh", "--factor", 1)
    machine = Machine()
    try:
        given, numbers = line_up(machine)
        paused = numbers["close_gripper"]
        assert machine.call(ControlCommand, CONTROL, command_id=paused, request="pause").success
        machine.wait_for(lambda: any("turn" in told.step for told in given["demo"].told), "the arms to be under way")
        end()
    finally:
        machine.close()
    unfinished = {note.symbol for note in unfinished_commands.noted(names.run_dir())}
    assert "close_gripper" in unfinished
    wanted = {numbers[symbol] for symbol in unfinished}
    for start in range(starts):
        if start:
            leftovers.end_all()
        said = machines()
        for symbol in unfinished:
            assert f"start: {symbol} (number {numbers[symbol]} of dispatcher) had not ended and is paused" in said
            assert f"im run --resume {numbers[symbol]} goes on with it, --cancel {numbers[symbol]} ends it" in said
        require_stillness()
        # a dispatcher that has not begun to fire, on a busy computer, has not taken the pauses either
        wait_until(lambda: wanted <= {n for n, line in under_way().items() if " paused" in line}, "the pauses")
    for symbol in ("demo", "home", "move"):
        resume(symbol, numbers[symbol])
    for symbol in ("demo", "home", "move"):
        ended = client("run_command", "--attach", numbers[symbol])
        printed, complaint = ended.communicate(timeout=COMMAND_S)
        assert (ended.returncode, complaint) == (0, ""), printed
    resume("close_gripper", paused)
    ended = client("run_command", "--attach", paused, "--json")
    printed, complaint = ended.communicate(timeout=COMMAND_S)
    assert ended.returncode == 0, complaint
    assert json.loads(printed)["width"] == pytest.approx(0.02, abs=1e-3)


def test_what_a_machine_was_given_outlives_its_death_and_a_new_mission_takes_nothing_of_the_one_before(machines):
    """A queue of commands is set aside whole: named, kept, and carried out by nobody; no number stands for another."""
    machines("--fresh")
    machine = Machine()
    try:
        assert machine.call(LoadNet, "/dispatcher/load_net", net_yaml=GREET).success
    finally:
        machine.close()
    put = client("data_objects", "put", "mark", "std_msgs/msg/String", '{"data": "here"}')
    assert put.wait(COMMAND_S) == 0
    leftovers.end_all()
    assert "was not stopped but died: its loaded nets and data objects are there again" in machines("--factor", 1)
    greeted = client("run_command", "greet").communicate(timeout=COMMAND_S)
    assert "done" in greeted[0], greeted
    assert '"here"' in client("data_objects", "get", "mark").communicate(timeout=COMMAND_S)[0]
    machine = Machine()
    try:
        _, numbers = line_up(machine)
        leftovers.end_all()
    finally:
        machine.close()
    unfinished = [note.symbol for note in unfinished_commands.noted(names.run_dir())]
    assert "move" in unfinished  # on a busy computer what was given first may have ended
    said = machines("--fresh")
    assert not [symbol for symbol in unfinished if f"{symbol} (number {numbers[symbol]} of dispatcher)" not in said], (
        said
    )
    kept = max((names.run_dir() / "missions").iterdir(), key=lambda folder: folder.stat().st_mtime_ns)
    assert str(kept) in said
    assert {note.number for note in unfinished_commands.noted(kept)} == {numbers[symbol] for symbol in unfinished}
    assert "number" not in client("run_command").communicate(timeout=COMMAND_S)[0]
    ended = client("run_command", "--attach", numbers["move"])
    printed, complaint = ended.communicate(timeout=COMMAND_S)
    assert ended.returncode == 1, printed
    assert f"the machine was started anew before it had ended; what it has left is kept in {kept}" in complaint
    homed = client("run_command", "home", "--group", "left")
    printed, complaint = homed.communicate(timeout=COMMAND_S)
    assert homed.returncode == 0, printed + complaint
