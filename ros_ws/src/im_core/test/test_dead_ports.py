"""Ports of killed readers are held where processes still write: Fast DDS gives them to nobody."""

import mmap
import os
from contextlib import ExitStack

import pytest

from im_core import dead_ports
from im_core.dead_ports import MOST_HELD, UNFINISHED_S, end_unfinished, own_ports, passed_over
from im_core.shm_names import SHM, lock, mapped

#: First word of a port as boost leaves it.
FINISHED = b"\2\0\0\0"


@pytest.fixture
def port(tmp_path, monkeypatch):
    """Makes a port and its lock file, whose reader lives or not, with the port in the memory of a process or not."""
    monkeypatch.setattr(dead_ports, "SHM", tmp_path)
    written = set()
    monkeypatch.setattr(dead_ports, "mapped", lambda: written)
    with ExitStack() as held:

        def make(number, lives=False, in_memory=True):
            path = tmp_path / f"fastrtps_port{number}_el"
            path.touch()
            (tmp_path / f"fastrtps_port{number}").write_bytes(FINISHED)
            if lives:
                held.callback(os.close, lock(path))
            if in_memory:
                written.add(f"fastrtps_port{number}")
            return path

        yield make


def is_free(path):
    try:
        os.close(lock(path))
    except OSError:
        return False
    return True


def test_ports_of_killed_readers_are_held_while_a_node_is_made(port):
    dead, _, unused, gone = port(7411), port(7413, lives=True), port(7415, in_memory=False), port(7417)
    gone.with_name("fastrtps_port7417").unlink()
    with passed_over() as passed:
        assert passed == ["fastrtps_port7411"]
        assert not is_free(dead)
        assert is_free(unused)
        assert is_free(gone)
    assert is_free(dead)


def test_processes_that_begin_at_once_pass_over_the_same_ports(port):
    port(7411)
    with passed_over() as first, passed_over() as second:
        assert first == second == ["fastrtps_port7411"]


def test_other_files_of_fast_dds_are_left_alone(tmp_path, port):
    port(7411).unlink()
    (tmp_path / "fastrtps_port7411_el").symlink_to("/etc/passwd")
    for name in ("fastrtps_port7411_sl", "fastrtps_0123456789abcdef_el", "fastrtps_port_el"):
        (tmp_path / name).touch()
    with passed_over() as passed:
        assert passed == []


def test_the_last_made_are_held_where_there_are_too_many(tmp_path, port):
    paths = [port(7400 + number) for number in range(MOST_HELD + 3)]
    for number in range(len(paths)):
        os.utime(tmp_path / f"fastrtps_port{7400 + number}", (number, number))
    with passed_over():
        assert [is_free(path) for path in paths] == [True] * 3 + [False] * MOST_HELD
    assert all(map(is_free, paths))


def test_a_process_that_reads_a_port_is_seen(tmp_path, port):
    port(7411)
    assert not own_ports()
    descriptor = lock(port(7413))
    assert own_ports() == {"fastrtps_port7413"}
    os.close(descriptor)


def test_a_removed_file_in_memory_is_seen():
    name = f"im_test_{os.getpid()}"
    path = SHM / name
    path.write_bytes(b"written")
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0):
        path.unlink()
        assert name in mapped()
    assert name not in mapped()


@pytest.mark.parametrize("content", [b"", b"\0", b"\0" * 8, b"\1" + b"\0" * 7], ids=["empty", "marked", "new", "begun"])
def test_a_port_whose_maker_was_killed_is_marked_as_failed_and_removed(tmp_path, port, content):
    port(7411)
    path = tmp_path / "fastrtps_port7413"
    path.write_bytes(content)
    with path.open("rb") as waits:
        assert end_unfinished(), "its maker may live"
        old = path.stat().st_mtime - UNFINISHED_S
        os.utime(path, (old, old))
        assert not end_unfinished()
        assert waits.read() == (b"\3\0\0\0" + content[4:] if content[1:] else b"\0")
    assert not path.exists()
    assert (tmp_path / "fastrtps_port7411").read_bytes() == FINISHED


def test_a_process_begins_once_an_unfinished_port_is_removed(tmp_path, port, monkeypatch):
    monkeypatch.setattr(dead_ports, "UNFINISHED_S", 0.2)
    (tmp_path / "fastrtps_port7413").touch()
    with passed_over():
        assert not (tmp_path / "fastrtps_port7413").exists()
