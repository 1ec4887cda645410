"""A command outlives its machine: everything is killed in the middle of it, and the next start goes on with it."""

import json
import subprocess
import sys

import pytest

from bench.chaos.everything import DEVIATIONS, distance
from im_bringup.machine import leftovers
from im_core import names, open_commands
from support.whole_machine import COMMAND_S, SEED, free_port, run_script, write_few_poses

pytestmark = pytest.mark.end_to_end


@pytest.fixture
def machines():
    """Starts machines, one after the death of the other; the last is stopped."""

    def start(*options):
        started = run_script("start", *options, "--factor", 0, "--seed", SEED, "--port", free_port())
        assert started.returncode == 0, started.stdout + started.stderr
        return started.stdout

    yield start
    assert run_script("stop").returncode == 0


def client(module, *arguments):
    """A command of the shell that runs beside the test."""
    argv = [sys.executable, "-m", f"im_bringup.ros.{module}", *map(str, arguments)]
    return subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def kill_everything_at(command, lines):
    """Kills all processes of the machine when a command has told so many lines of progress."""
    for _ in range(lines):
        while not (line := command.stderr.readline()).startswith("["):
            assert line, "the command ended before its machine was killed"
    _, remaining = leftovers.end_all(timeout_s=30.0)
    assert not remaining
    command.kill()
    command.communicate()


def test_a_calibration_goes_on_after_the_death_of_everything(machines, tmp_path):
    """It finds what it would have found, within the noise that the testbed draws anew."""
    poses = write_few_poses(tmp_path)
    machines("--fresh")
    undisturbed = client("calibrate_camera", "--json", "--poses", poses)
    printed, said = undisturbed.communicate(timeout=COMMAND_S)
    assert undisturbed.returncode == 0, said
    kill_everything_at(client("calibrate_camera", "--json", "--poses", poses), 4)
    (unfinished,) = open_commands.noted(names.run_dir())
    assert "and go on: calibrate_camera" in machines()
    ended = client("run_command", "--attach", unfinished.number, "--json")
    resumed, said = ended.communicate(timeout=COMMAND_S)
    assert ended.returncode == 0, said
    report, reference = json.loads(resumed)["report"], json.loads(printed)
    assert report["points_used"] >= reference["points_used"] - 2  # an arm that comes from elsewhere may hide the light
    assert distance(report, reference) <= DEVIATIONS
