"""Ports of killed processes are held: Fast DDS gives them to nobody."""

import os

import pytest

from im_bringup.tasks import dead_ports
from im_bringup.tasks.dead_ports import MOST_HELD, DeadPorts
from im_core.shm_names import lock

DOMAIN = 5
FIRST = 7400 + 250 * DOMAIN


@pytest.fixture
def shm(tmp_path, monkeypatch):
    monkeypatch.setattr(dead_ports, "SHM", tmp_path)
    return tmp_path


@pytest.fixture
def lock_of(shm):
    """Makes the lock file of a port, held by a living process or not."""
    opened = []

    def make(port, held=False):
        path = shm / f"fastrtps_port{port}_el"
        path.touch()
        if held:
            opened.append(lock(path))
        return path

    yield make
    for descriptor in opened:
        os.close(descriptor)


def is_free(path):
    try:
        os.close(lock(path))
    except OSError:
        return False
    return True


def test_ports_of_the_dead_are_held_until_the_end(lock_of):
    dead, _, other = lock_of(FIRST + 11), lock_of(FIRST + 13, held=True), lock_of(FIRST + 250)
    ports = DeadPorts(DOMAIN)
    assert ports.hold() == [FIRST + 11]
    assert not is_free(dead)
    assert is_free(other)
    assert ports.hold() == []
    ports.close()
    assert is_free(dead)


def test_other_files_of_fast_dds_are_left_alone(shm, lock_of):
    for name in ("fastrtps_port7400_sl", "fastrtps_0123456789abcdef_el", f"fastrtps_port{FIRST}", "fastrtps_port_el"):
        (shm / name).touch()
    (shm / f"fastrtps_port{FIRST + 11}_el").symlink_to("/etc/passwd")
    assert DeadPorts(DOMAIN).hold() == []


def test_the_oldest_are_given_back_where_there_are_too_many(lock_of):
    paths = [lock_of(FIRST + number) for number in range(MOST_HELD + 3)]
    ports = DeadPorts(DOMAIN)
    assert len(ports.hold()) == len(paths)
    assert [is_free(path) for path in paths] == [True] * 3 + [False] * MOST_HELD
