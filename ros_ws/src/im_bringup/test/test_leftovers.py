import fcntl
import mmap
import os
import re
import subprocess
import sys
import threading
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


def test_shared_memory_of_the_dead_is_removed_and_that_of_the_living_stays(instance):
    dead, alive = f"fastrtps_{os.getpid():016x}", f"fastrtps_{os.getpid() + 1:016x}"
    port = f"fastrtps_port{30_000 + os.getpid() % 9999}"
    blocks = [f"{instance}_testbed", f"sem.{instance}_state", f".{instance}_machine.json.1.1"]
    gone = [dead, f"{dead}_el", f"sem.{dead}_mutex", *blocks]
    kept = [alive, f"{alive}_el", f"{instance}0_testbed", port, f"{port}_el", f"sem.{port}_mutex"]
    for name in gone + kept:
        (SHM / name).touch()
    try:
        (SHM / alive).write_bytes(b"segment")
        with (SHM / f"{alive}_el").open() as lock, (SHM / alive).open() as file:
            fcntl.flock(lock, fcntl.LOCK_EX)
            memory = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
            assert set(gone) <= set(leftovers.remove_shared_memory())
            assert [name for name in gone + kept if (SHM / name).exists()] == kept
            memory.close()
    finally:
        for name in gone + kept:
            (SHM / name).unlink(missing_ok=True)


def test_who_takes_long_to_die_is_waited_for():
    """A killed process on a busy computer: its memory is gone, its lock is not given back yet."""
    segment = f"fastrtps_{os.getpid() + 2:016x}"
    for name in (segment, f"{segment}_el"):
        (SHM / name).touch()
    with (SHM / f"{segment}_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        threading.Timer(1.5, fcntl.flock, (lock, fcntl.LOCK_UN)).start()
        leftovers.remove_shared_memory()  # another process may have removed them at the same moment
        assert not [name for name in (segment, f"{segment}_el") if (SHM / name).exists()]


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
    block, segment, mine = SHM / f"{instance}_testbed", SHM / f"fastrtps_{os.getpid() + 3:016x}", os.geteuid()
    for path in (block, segment):
        path.touch()
    try:
        monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
        assert leftovers.remove_shared_memory() == []
        told = leftovers.foreign_sentence(leftovers.of_others())
        assert re.match(rf"{block} belongs to user {mine}\b.*, not to you; remove it, or set another ROS_DOMAIN", told)
        assert block.exists()
        assert segment.exists()
    finally:
        for path in (block, segment):
            path.unlink()


def test_a_lock_of_the_middleware_that_leads_elsewhere_is_neither_followed_nor_waited_for(tmp_path):
    """A reader of a FIFO waits for a writer."""
    segment, target = f"fastrtps_{os.getpid() + 4:016x}", tmp_path / "target"
    names = (segment, f"{segment}_el", f"{segment}_sl")
    (SHM / names[0]).touch()
    (SHM / names[1]).symlink_to(target)
    os.mkfifo(target)
    os.mkfifo(SHM / names[2])
    try:
        assert not leftovers._unlocked(SHM / names[1])
        assert leftovers._unlocked(SHM / names[2])
    finally:
        for name in names:
            (SHM / name).unlink()
