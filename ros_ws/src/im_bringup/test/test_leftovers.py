import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from im_bringup.machine import leftovers
from im_bringup.tasks.agent import MARKER
from im_core import clock

SHM = Path("/dev/shm")


@pytest.fixture
def instance(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(20_000 + os.getpid()))
    return f"im{20_000 + os.getpid()}"


def test_processes_are_found_by_their_machine_and_killed(instance):
    code = [sys.executable, "-S", "-c", "import time; time.sleep(30)"]
    mine = subprocess.Popen(code, env={**os.environ, MARKER: instance})
    other = subprocess.Popen(code, env={**os.environ, MARKER: instance + "0"})
    try:
        deadline = clock.monotonic() + 60.0
        while [process.pid for process in leftovers.processes()] != [mine.pid]:
            assert clock.monotonic() < deadline
            clock.sleep(0.01)
        assert leftovers.kill(leftovers.processes(), timeout_s=60.0) == []
        assert mine.wait(60.0) == -9
        assert other.poll() is None
    finally:
        for process in (mine, other):
            process.kill()
            process.wait()


def test_shared_memory_of_the_machine_is_removed_and_that_of_another_stays(instance):
    gone = [f".{instance}_machine.json.1.1", f"{instance}_testbed", f"sem.{instance}_state"]
    kept = f"{instance}0_testbed"
    for name in (*gone, kept):
        (SHM / name).touch()
    try:
        assert sorted(leftovers.remove_shared_memory()) == gone
        assert (SHM / kept).exists()
    finally:
        for name in (*gone, kept):
            (SHM / name).unlink(missing_ok=True)


def test_what_no_machine_has_left_is_not_said_to_be_another_users(instance):
    folder = SHM / f"{instance}_machine.json"
    folder.mkdir()
    try:
        leftovers.remove_shared_memory()
        told = leftovers.foreign_sentence(leftovers.of_others())
        assert told.startswith(f"{folder} cannot be removed; no machine has left it there")
    finally:
        folder.rmdir()


def test_what_another_user_has_left_is_told_and_stops_no_sweep(instance, monkeypatch):
    """This process takes itself for another user: also root leaves alone what is not its own."""
    block, mine = SHM / f"{instance}_testbed", os.geteuid()
    block.touch()
    try:
        monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
        assert leftovers.remove_shared_memory() == []
        told = leftovers.foreign_sentence(leftovers.of_others())
        assert re.match(rf"{block} belongs to user {mine}\b.*, not to you; remove it, or set another ROS_DOMAIN", told)
        assert block.exists()
    finally:
        block.unlink()
