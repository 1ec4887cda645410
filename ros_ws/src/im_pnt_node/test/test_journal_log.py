"""The log of a journal: torn and damaged files, disks that fail, two processes, versions."""

import json
import os
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.errors import JournalError
from im_pnt_node.journal import log as module
from im_pnt_node.journal.folder import Folder
from im_pnt_node.journal.log import Log, Sync, discard, frame, scan
from support.memory_files import MemoryFiles

HEADER = {"node": "n", "nets": {}}
BATCHES = [[["net", "a", ["token", "p", 1]]], [["x", 1.5], ["y", "ü\n"]], [], [["z" * 300]]]


def written(files: MemoryFiles) -> bytes:
    log = Log(files, Sync.OS)
    assert log.recover() is None
    log.replace(HEADER, {"state": 1})
    for batch in BATCHES:
        log.append(json.dumps(batch))
    log.close()
    assert files.names() == ["000001.journal"]
    return files.read("000001.journal")


def reread(content: bytes):
    files = MemoryFiles()
    files.contents["000001.journal"] = bytearray(content)
    return Log(files, Sync.OS).recover()


def ends_of(content: bytes) -> list[int]:
    return [offset + 1 for offset, byte in enumerate(content) if byte == 10]


def test_what_was_written_is_read_and_a_person_can_read_it():
    content = written(MemoryFiles())
    recovered = reread(content)
    assert recovered.header["format"] == "im_pnt journal"
    assert recovered.state == {"state": 1}
    assert [batch for _, batch in recovered.batches] == BATCHES
    assert recovered.torn == 0
    assert content.decode("ascii").splitlines()[2].endswith('[["net", "a", ["token", "p", 1]]]')


def test_cut_at_each_byte_the_last_record_is_dropped_and_what_was_before_it_is_kept():
    content = written(MemoryFiles())
    ends = ends_of(content)
    for size in range(len(content)):
        whole = [end for end in ends if end <= size]
        if len(whole) < 2:
            with pytest.raises(JournalError, match="every journal has a header and a snapshot") as error:
                reread(content[:size])
            assert error.value.facts["record"] == len(whole) + 1
            continue
        recovered = reread(content[:size])
        assert [batch for _, batch in recovered.batches] == BATCHES[: len(whole) - 2]
        assert recovered.torn == size - whole[-1]
        assert recovered.size == whole[-1]


def test_with_any_byte_changed_nothing_is_read_and_the_place_is_named():
    content = written(MemoryFiles())
    ends = ends_of(content)
    for offset in range(len(content)):
        number = sum(end <= offset for end in ends) + 1
        for change in (0x01, 0x20, 0x80, 0xFF):
            damaged = bytearray(content)
            damaged[offset] ^= change
            with pytest.raises(JournalError, match=r"record \d+ at byte \d+") as error:
                reread(bytes(damaged))
            assert error.value.facts["record"] == number
            assert error.value.facts["offset"] == ([0, *ends])[number - 1]


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_no_content_whatever_breaks_the_reader(content):
    try:
        found = scan(content, "file", Sync.OS)
    except JournalError:
        return
    assert found.size + found.torn == len(content)


def test_a_record_that_was_taken_out_or_moved_is_noticed():
    lines = written(MemoryFiles()).splitlines(keepends=True)
    for damaged in (lines[:3] + lines[4:], [*lines[:2], lines[3], lines[2], *lines[4:]], lines[:3] + lines[2:]):
        with pytest.raises(JournalError, match="its checksum is"):
            reread(b"".join(damaged))


def test_a_file_that_a_power_cut_left_longer_than_its_content_loses_only_its_last_record():
    content = written(MemoryFiles())
    size = ends_of(content)[-2]
    recovered = reread(content[: size + 7] + bytes(500))
    assert [batch for _, batch in recovered.batches] == BATCHES[:-1]


@pytest.mark.parametrize("sync", Sync)
def test_after_a_loss_of_power_what_was_synchronised_is_there_and_of_the_rest_a_beginning(sync):
    """Whichever sectors of what was not synchronised the disk has filled."""
    batches = [json.dumps([["x" * length, number]]) for number, length in enumerate((5, 300, 2000, 40, 700, 9, 5000))]
    files = MemoryFiles()
    log = Log(files, sync)
    log.replace(HEADER, {"state": 1})
    lost = 0
    for count, batch in enumerate(batches, start=1):
        log.append(batch)
        for seed in range(200):
            unplugged = files.unplugged(Random(seed))
            recovered = Log(unplugged, sync).recover()
            found = [record.body.decode() for record, _ in recovered.batches]
            assert found == batches[: len(found)]
            assert sync is Sync.OS or len(found) == count
            lost += count - len(found)
    assert (lost > 0) is (sync is Sync.OS)


def test_a_loss_of_power_while_a_batch_is_written_takes_that_batch_only():
    """The disk has some of its sectors, in any order, and has not said that it has them."""
    files = MemoryFiles()
    log = Log(files, Sync.DISK)
    log.replace(HEADER, {"state": 1})
    log.append('[["safe"]]')
    files.dies_after(1)  # it is written, and not synchronised
    with pytest.raises(MemoryFiles.Death):
        log.append(json.dumps([["y" * 3000]]))
    torn = set()
    for seed in range(300):
        recovered = Log(files.unplugged(Random(seed)), Sync.DISK).recover()
        assert [record.body for record, _ in recovered.batches][:1] == [b'[["safe"]]']
        torn.add(recovered.torn)
    assert len(torn) > 10


def test_zeros_in_what_was_synchronised_are_damage():
    content = bytearray(written(MemoryFiles()))
    content += frame(json.dumps([["z" * 3000]]).encode(), int(content.splitlines()[-1][9:17], 16))[0]
    end = content.rindex(b"\n", 0, -1) + 1
    content[end + 600 : end + 1700] = bytes(1100)
    files = MemoryFiles()
    more, _ = frame(b"[]", 0)
    files.contents["000001.journal"] = content + more
    with pytest.raises(JournalError, match="record 7 at byte"):
        Log(files, Sync.DISK).recover()
    assert Log(files.reborn(), Sync.OS).recover().torn == len(content) + len(more) - end


def test_other_versions_and_other_files_are_refused():
    def file_of(*bodies: str) -> bytes:
        content, checksum = b"", 0
        for body in bodies:
            line, checksum = frame(body.encode(), checksum)
            content += line
        return content

    for bodies, reason in (
        (('{"format":"im_pnt journal","version":1}', "{}"), "it has version 1, and version 3 is read here; noth"),
        (('{"format":"im_pnt journal","version":99}', "{}"), "it has version 99, and version 3 is read here"),
        (('{"format":"diary"}', "{}"), "its header is not one of an im_pnt journal"),
        (("[]", "{}"), "its header is not one"),
        (('{"format":"im_pnt journal","version":3}', "[]"), "the snapshot is not a JSON object"),
        (('{"format":"im_pnt journal","version":3}', "{}", "{}"), "it is not a JSON list of entries"),
        (('{"format":"im_pnt journal","version":3}', "{}", "[["), "it is not JSON"),
    ):
        with pytest.raises(JournalError, match=reason):
            reread(file_of(*bodies))


def test_writing_goes_on_behind_the_last_whole_record(tmp_path):
    folder = Folder(tmp_path)
    log = Log(folder, Sync.DISK)
    log.recover()
    log.replace(HEADER, {})
    log.append('["first"]')
    log.append('["torn"]')
    log.close()
    path = tmp_path / "000001.journal"
    path.write_bytes(path.read_bytes()[:-4])
    log = Log(folder, Sync.OS)
    assert [batch for _, batch in log.recover().batches] == [["first"]]
    log.append('["second"]')
    log.close()
    assert [batch for _, batch in Log(folder, Sync.OS).recover().batches] == [["first"], ["second"]]


def test_a_new_file_replaces_the_old_one_whenever_the_process_dies():
    files = MemoryFiles()
    log = Log(files, Sync.OS)
    log.recover()
    log.replace(HEADER, {"state": 1})
    log.append('["entry"]')
    for steps in range(8):
        trial = files.copy()
        trial.dies_after(steps)
        other = Log(trial, Sync.OS)
        died = False
        try:
            other.recover()
            other.replace(HEADER, {"state": 2})
        except MemoryFiles.Death:
            died = True
        recovered = Log(trial.reborn(), Sync.OS).recover()
        assert recovered.state in ({"state": 1}, {"state": 2})
        assert died or recovered.state == {"state": 2}
        assert len(recovered.batches) == (recovered.state == {"state": 1})
    assert not died


def test_where_the_disk_is_full_nothing_is_half_written():
    files = MemoryFiles()
    log = Log(files, Sync.OS)
    log.recover()
    log.replace(HEADER, {})
    files.full = True
    with pytest.raises(JournalError, match=r"cannot be written: .*No space left"):
        log.append('["lost"]')
    with pytest.raises(JournalError, match="cannot be written"):
        log.replace(HEADER, {})
    assert [name for name in files.names() if name.endswith(".new")] == []
    files.full = False
    log.append('["kept"]')
    assert [batch for _, batch in Log(files, Sync.OS).recover().batches] == [["kept"]]


def test_a_snapshot_that_is_too_long_leaves_the_old_file(tmp_path, monkeypatch):
    """Its length would have a digit too many, and the next start would call it damage."""
    monkeypatch.setattr(module, "MOST_BYTES", 200)
    log = Log(Folder(tmp_path), Sync.OS)
    log.replace(HEADER, {"n": 1})
    with pytest.raises(JournalError, match=r"a record of 3\d\d bytes; at most 200"):
        log.replace(HEADER, {"n": "x" * 300})
    log.append('["kept"]')
    log.close()
    recovered = Log(Folder(tmp_path), Sync.OS).recover()
    assert (recovered.state, [batch for _, batch in recovered.batches]) == ({"n": 1}, [["kept"]])


def test_a_real_file_that_cannot_grow_keeps_what_it_had(tmp_path):
    program = f"""
import resource, signal
from pathlib import Path
from im_pnt.errors import JournalError
from im_pnt_node.journal.folder import Folder
from im_pnt_node.journal.log import Log, Sync
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
log = Log(Folder(Path({str(tmp_path)!r})), Sync.OS)
log.recover()
log.replace({HEADER!r}, {{}})
resource.setrlimit(resource.RLIMIT_FSIZE, (300, resource.RLIM_INFINITY))
try:
    log.append('["' + 'x' * 1000 + '"]')
except JournalError as error:
    print(error)
log.append('["small"]')
"""
    done = python(program)
    assert "File too large" in done.stdout
    assert [batch for _, batch in Log(Folder(tmp_path), Sync.OS).recover().batches] == [["small"]]


def test_a_journal_belongs_to_one_process_and_the_other_is_named(tmp_path):
    folder = Folder(tmp_path)
    folder.lock()
    program = f"""
from pathlib import Path
from im_pnt_node.journal.folder import Folder
Folder(Path({str(tmp_path)!r})).lock()
"""
    done = python(program)
    assert f"the journal is in use by process {os.getpid()};" in done.stderr
    folder.unlock()
    done = python(program)
    assert done.returncode == 0
    folder.lock()


def test_a_journal_is_moved_aside_and_never_deleted(tmp_path):
    folder = Folder(tmp_path)
    assert discard(folder) is None
    log = Log(folder, Sync.OS)
    log.recover()
    log.replace(HEADER, {})
    log.close()
    content = (tmp_path / "000001.journal").read_bytes()
    aside = discard(folder, lambda: "stamp")
    assert (tmp_path / aside / "000001.journal").read_bytes() == content
    assert Log(folder, Sync.OS).recover() is None


def python(program: str) -> subprocess.CompletedProcess:
    paths = os.pathsep.join(path for path in sys.path if path and Path(path).is_dir())
    environment = {**os.environ, "PYTHONPATH": paths}
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
