import json
import multiprocessing
import os
import signal
import stat
import subprocess
import sys
from collections import deque
from contextlib import closing
from pathlib import Path

import numpy as np
import posix_ipc
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core import clock
from im_core.errors import DataError, LinkError
from im_core.processes.procfs import ProcessId
from im_core.shm import MessageRing, Semaphore, SharedBlock, SharedRecord, Snapshot, dead_owner
from im_core.shm_names import remove_all

PREFIX = f"imtest{os.getpid()}_"
SPAWN = multiprocessing.get_context("spawn")
#: Creates and fills a block that is larger than what is free in ``/dev/shm``, and a small one.
TOO_LARGE = """
from im_core.errors import LinkError
from im_core.shm import SharedBlock

try:
    SharedBlock.create("large", 4 * 2**20).array("u1", 4 * 2**20)[:] = 1
except LinkError as error:
    print(error)
with SharedBlock.create("small", 2**19) as block:
    block.array("u1", 2**19)[:] = 1
"""
RECORD = np.dtype([("count", "<i8"), ("values", "<f8", (200,))])
SNAPSHOT = np.dtype([("newest", Snapshot.layout(RECORD))], align=True)


class Doorbell(SharedRecord):
    """A snapshot, and a semaphore for each side."""

    SEMAPHORES = ("front", "back")

    def __init__(self, block, dtype, semaphores):
        super().__init__(block, dtype, semaphores)
        self.front, self.back = semaphores
        self.newest = Snapshot(self.view["newest"], self.name)


@pytest.fixture(autouse=True)
def _nothing_left():
    yield
    assert remove_all(PREFIX) == []


def create_and_wait(name):
    block = SharedBlock.create(name, 8)
    block.publish()
    signal.pause()


def write_snapshots(name):
    bell = Doorbell.attach(name, SNAPSHOT, timeout_s=60.0)
    snapshot = bell.newest
    record = snapshot.record()
    for count in range(1, 20_000):
        record["count"] = count
        record["values"][:] = count
        snapshot.write(record)
    bell.close()


@pytest.fixture
def other_process_with_block():
    name = PREFIX + "block"
    process = SPAWN.Process(target=create_and_wait, args=(name,), daemon=True)
    process.start()
    SharedBlock.attach(name, timeout_s=60.0).close()
    yield name, process
    process.kill()
    process.join()
    remove_all(PREFIX)


def test_block_of_a_living_process_is_not_replaced(other_process_with_block):
    name, process = other_process_with_block
    with pytest.raises(LinkError, match=rf"'{name}' is in use by process {process.pid}.*ROS_DOMAIN_ID"):
        SharedBlock.create(name, 8)


def test_block_of_a_killed_process_is_refused_to_readers_and_replaced_by_creators(other_process_with_block):
    name, process = other_process_with_block
    attached = SharedBlock.attach(name, timeout_s=0.0)
    assert attached.owner_alive()
    os.kill(process.pid, signal.SIGKILL)  # not reaped yet: a zombie counts as dead
    while ProcessId.of(process.pid).start >= 0:
        clock.sleep(0.005)
    assert not attached.owner_alive()
    with pytest.raises(LinkError, match=f"left behind by process {process.pid}, which is gone"):
        SharedBlock.attach(name, timeout_s=0.0)
    with SharedBlock.create(name, 8) as block:
        block.publish()
        SharedBlock.attach(name, timeout_s=0.0).close()


def test_unpublished_or_missing_block_cannot_be_attached():
    name = PREFIX + "half"
    with pytest.raises(LinkError, match="does not exist"):
        SharedBlock.attach(name, timeout_s=0.0)
    with SharedBlock.create(name, 8), pytest.raises(LinkError, match="is not initialised"):
        SharedBlock.attach(name, timeout_s=0.0)


def test_block_has_all_its_pages_from_the_beginning():
    with SharedBlock.create(PREFIX + "whole", 10**6):
        assert 512 * os.stat(f"/dev/shm/{PREFIX}whole").st_blocks >= 10**6


def test_block_for_which_there_is_no_room_is_an_error_and_leaves_nothing():
    """In a mount namespace whose ``/dev/shm`` has 1 MiB."""
    apart = ("unshare", "--map-root-user", "--mount", "sh", "-c")
    mount = "mount -t tmpfs -o size=1m tmpfs /dev/shm"
    if subprocess.run([*apart, mount], capture_output=True, check=False).returncode != 0:
        pytest.skip("this process may not mount a file system of its own")
    script = f'{mount} && exec "$0" -c "$1"'
    done = subprocess.run([*apart, script, sys.executable, TOO_LARGE], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "no room for the 4194368 bytes of the shared memory 'large': No space left on device" in done.stdout


def test_snapshot_is_never_torn():
    name = PREFIX + "snapshot"
    bell = Doorbell.create(name, SNAPSHOT)
    snapshot = bell.newest
    writer = SPAWN.Process(target=write_snapshots, args=(name,))
    writer.start()
    last, reads = 0, 0
    while last < 19_999:
        record = snapshot.read()
        assert (record["values"] == record["count"]).all()
        assert record["count"] >= last
        last, reads = int(record["count"]), reads + 1
        assert writer.is_alive() or snapshot.sequence == 19_999
    writer.join()
    assert reads > 10
    bell.close()


def test_record_of_another_size_is_refused():
    name = PREFIX + "record"
    with closing(Doorbell.create(name, SNAPSHOT)), pytest.raises(LinkError, match=f"'{name}' has 1616 bytes, not 8"):
        SharedRecord.attach(name, np.dtype([("count", "<i8")]), timeout_s=0.0)


def test_fields_and_semaphores_of_a_record_are_those_of_both_sides():
    name = PREFIX + "record"
    with closing(Doorbell.create(name, SNAPSHOT)) as mine, closing(Doorbell.attach(name, SNAPSHOT, 0.0)) as its:
        record = mine.newest.record()
        record["count"] = 7
        mine.newest.write(record)
        assert its.newest.read()["count"] == 7
        mine.front.post()
        assert not its.back.wait(0.0)
        assert its.front.wait(0.0)
        assert its.owner_alive()
        mine.unlink()
        with pytest.raises(LinkError, match="does not exist"):
            Doorbell.attach(name, SNAPSHOT, 0.0)
        its.back.post()
        assert mine.back.wait(0.0), "without names, both sides keep what they have"


def test_a_record_is_there_when_all_its_semaphores_are_and_leaves_nothing_if_one_is_not(monkeypatch):
    name, create = PREFIX + "record", Semaphore.create

    def no_room(part):
        if part.endswith("back"):
            with pytest.raises(LinkError, match="is not initialised"):
                SharedBlock.attach(name, timeout_s=0.0)
            raise LinkError("there is no room")
        return create(part)

    monkeypatch.setattr(Semaphore, "create", no_room)
    with pytest.raises(LinkError, match="there is no room"):
        Doorbell.create(name, SNAPSHOT)


def test_snapshot_of_a_writer_that_died_while_writing_is_an_error():
    snapshot = Snapshot(np.zeros((), Snapshot.layout(RECORD)), "newest")
    snapshot._sequence[()] = 3
    with pytest.raises(LinkError, match="stopped in the middle of a write"):
        snapshot.read()
    began = clock.monotonic()
    for _ in range(10):  # a loop that looks again and again is not kept
        with pytest.raises(LinkError, match="stopped in the middle of a write"):
            snapshot.read()
    assert clock.monotonic() - began < 0.5
    snapshot.write(snapshot.record())
    assert snapshot.read()["count"] == 0


VALUES = st.integers() | st.text(max_size=20) | st.binary(max_size=20) | st.lists(st.binary(max_size=5), max_size=2)


def most_bytes(message):
    """What a message takes in a ring, or a little more."""
    return 8 + len(json.dumps(message, default=lambda value: "x" * (len(value) + 20)))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.none() | st.dictionaries(st.text(max_size=5), VALUES)))
def test_ring_is_a_queue(operations):
    """Against a deque: None takes a message, anything else is sent."""
    ring = MessageRing(np.zeros((), MessageRing.layout(256)), "ring")
    expected = deque()
    for message in operations:
        if message is None:
            assert ring.receive() == (expected.popleft() if expected else None)
            continue
        try:
            ring.send(message)
        except LinkError:
            assert sum(map(most_bytes, [*expected, message])) > 256, "there was room"
        else:
            expected.append(message)
    assert list(ring.receive_all()) == list(expected)
    assert ring.empty()


def test_ring_refuses_what_is_not_json_and_says_when_it_is_full():
    memory = np.zeros((), MessageRing.layout(64))
    ring, reader = MessageRing(memory, "ring"), MessageRing(memory, "ring")
    for wrong in (float("nan"), {1}):
        with pytest.raises(DataError, match="is not JSON"):
            ring.send({"value": wrong})
    with pytest.raises(LinkError, match="is full: a message of 119 bytes, 64 of 64 free"):
        ring.send({"text": "x" * 100})
    ring.send({"a": [1, 2.5, None, "ü"]})
    assert reader.receive() == {"a": [1, 2.5, None, "ü"]}


def uses(name):
    """What may be done with a name in shared memory, and which file it is of."""
    block, semaphore = Path(f"/dev/shm/{name}"), Path(f"/dev/shm/sem.{name}")
    return [
        (block, lambda: SharedBlock.create(name, 64)),
        (block, lambda: SharedBlock.attach(name, 0.0)),
        (semaphore, lambda: Semaphore.create(name)),
        (semaphore, lambda: Semaphore.attach(name, 0.0)),
    ]


def test_what_belongs_to_another_user_is_refused_by_name_and_left_as_it_is(monkeypatch):
    """This process takes itself for another user, to whom its files are not its own."""
    name, mine = PREFIX + "owned", os.geteuid()
    with closing(SharedBlock.create(name, 64)) as block, closing(Semaphore.create(name)):
        block.publish()
        monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
        for path, use in uses(name):
            inode = path.stat().st_ino
            with pytest.raises(LinkError, match=f"^{path} belongs to user {mine}.*, not to you; remove it, or set "):
                use()
            assert path.stat().st_ino == inode
        assert remove_all(PREFIX) == []
        monkeypatch.undo()
        for _, attach in uses(name)[1::2]:
            attach().close()


def test_what_others_may_write_is_refused():
    name = PREFIX + "open"
    with closing(SharedBlock.create(name, 64)) as block, closing(Semaphore.create(name)):
        block.publish()
        for path, use in uses(name):
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            path.chmod(0o666)
            with pytest.raises(LinkError, match=rf"^{path} may be written by other users \(mode 666\)"):
                use()
            path.chmod(0o600)


def test_a_link_is_followed_neither_to_a_block_nor_to_a_semaphore(tmp_path):
    name, target = PREFIX + "link", tmp_path / "target"
    target.write_bytes(bytes(4096))
    for path, use in uses(name):
        path.symlink_to(target)
        try:
            made = use()
        except LinkError as error:
            assert "cannot be opened: [Errno 40] Too many levels of symbolic links" in str(error)  # noqa: PT017
            path.unlink()
        else:
            assert not path.is_symlink()
            made.close()
        assert target.read_bytes() == bytes(4096)


def test_a_semaphore_that_changes_hands_while_it_is_opened_is_not_taken(monkeypatch):
    name = PREFIX + "swapped"
    path = Path(f"/dev/shm/sem.{name}")
    real = posix_ipc.Semaphore

    def swap(*arguments):
        opened = real(*arguments)
        path.unlink()
        real(f"/{name}", posix_ipc.O_CREX, mode=0o600).close()
        return opened

    with closing(Semaphore.create(name)):
        monkeypatch.setattr(posix_ipc, "Semaphore", swap)
        with pytest.raises(LinkError, match="does not exist"):
            Semaphore.attach(name, timeout_s=0.0)


def test_semaphore_counts():
    owner = Semaphore.create(PREFIX + "semaphore")
    other = Semaphore.attach(PREFIX + "semaphore", timeout_s=0.0)
    assert not other.wait(0.0)
    owner.post()
    owner.post()
    assert other.wait(0.0)
    assert other.wait(0.1)
    assert not other.wait(0.01)
    owner.post()
    other.drain()
    assert not owner.wait(0.0)
    other.close()
    owner.close()
    with pytest.raises(LinkError, match="does not exist"):
        Semaphore.attach(PREFIX + "semaphore", timeout_s=0.0)


def test_the_owner_of_a_block_that_was_left_behind_is_found():
    name = f"{PREFIX}left"
    assert dead_owner(name) == 0
    with SharedBlock.create(name, 8):
        assert dead_owner(name) == 0, "the owner lives"
    code = f"import os; from im_core.shm import SharedBlock; SharedBlock.create({name!r}, 8).publish(); os._exit(0)"
    child = subprocess.Popen([sys.executable, "-c", code])
    child.wait()
    assert dead_owner(name) == child.pid
    SharedBlock.create(name, 8).close()
