"""A recording cut at any byte opens again, with every message that was whole; what is complete is left as it is."""

import fcntl
import os
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Metadata
from mcap.writer import IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from im_bag import files as bag_files
from im_bag.contents import MAGIC
from im_bag.files import LIBRARY, complete_bag
from im_bag.reading import open_bag
from im_core.errors import DataError

STRING = "std_msgs/msg/String"


def record(folder, chunks=6, each=5, end=True, library=LIBRARY, left_out=None):
    """A bag of some chunks of messages of two topics; positions in the file after each chunk."""
    folder.mkdir()
    ends = []
    with (folder / f"{folder.name}.mcap").open("wb") as file:
        writer = Writer(file, **(left_out or {}))
        writer.start(profile="ros2", library=library)
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for number in range(chunks * each):
            writer.add_message(channels[number % 2], 1000 + number, bytes([0, 1, 0, 0, number]), 900 + number, number)
            if number % each == each - 1:
                writer.flush()
                ends.append(file.tell())
        if end:
            writer.finish()
    return ends


def messages(folder):
    """Numbers of the messages, as rosbags and as the reader of mcap give them."""
    reader = open_bag(folder)
    first = [data[4] for _, _, data in reader.messages()]
    reader.close()
    with next(folder.glob("*.mcap")).open("rb") as file:
        second = [message.data[4] for _, _, message in make_reader(file, validate_crcs=True).iter_messages()]
    assert first == second
    return first


def test_a_file_cut_anywhere_opens_with_all_that_was_whole(tmp_path):
    ends = record(tmp_path / "whole")
    data = (tmp_path / "whole" / "whole.mcap").read_bytes()
    choose = random.Random(5)
    for cut in [ends[0], *(choose.randrange(ends[0], len(data)) for _ in range(40)), len(data) - 1]:
        folder = tmp_path / "bag"
        folder.mkdir()
        (folder / "bag.mcap").write_bytes(data[:cut])
        whole = sum(end <= cut for end in ends)
        found = messages(folder)
        # the chunk that was being written counts when it is whole itself, and only its index was cut
        assert found in (list(range(5 * whole)), list(range(5 * (whole + 1)))), cut
        shutil.rmtree(folder)


@pytest.mark.parametrize("content", [b"", MAGIC[:5], MAGIC, MAGIC + b"\x01\x09", bytes(100), bytes(5000)], ids=len)
def test_a_part_of_which_nothing_came_to_the_disk_is_no_part(tmp_path, content):
    record(tmp_path / "bag")
    begun = tmp_path / "bag" / "bag_1.mcap"
    begun.write_bytes(content)
    os.utime(begun, (0, 0))
    for _ in range(2):
        with closing(open_bag(begun.parent)) as reader:
            assert [data[4] for _, _, data in reader.messages()] == list(range(30))
    assert begun.read_bytes() == content
    with pytest.raises(DataError, match="has no message: the recording ended before the first was written"):
        complete_bag(begun)


def test_a_part_whose_beginning_is_lost_is_told(tmp_path):
    record(tmp_path / "bag")
    lost = tmp_path / "bag" / "bag_1.mcap"
    lost.write_bytes(bytes(4096) + b"data")
    with pytest.raises(DataError, match=r"bag_1\.mcap: is no MCAP file"):
        complete_bag(lost.parent)


def test_garbage_after_the_last_chunk_is_cut_off(tmp_path):
    record(tmp_path / "bag", end=False)
    with (tmp_path / "bag" / "bag.mcap").open("ab") as file:
        file.write(bytes(4096))
    assert messages(tmp_path / "bag") == list(range(30))


def spoil(path, at):
    data = bytearray(path.read_bytes())
    data[at] ^= 0xFF
    path.write_bytes(data)


def test_a_spoilt_chunk_is_left_out_and_what_follows_is_kept(tmp_path):
    ends = record(tmp_path / "bag", end=False)
    spoil(tmp_path / "bag" / "bag.mcap", ends[2] + 60)
    assert messages(tmp_path / "bag") == [*range(15), *range(20, 30)]


def test_a_spoilt_chunk_is_the_end_where_nothing_whole_follows(tmp_path):
    ends = record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    spoil(path, ends[4] + 60)
    assert messages(tmp_path / "bag") == list(range(25))
    assert path.stat().st_size < ends[4] + 2000


def test_chunks_whose_channels_were_in_a_spoilt_one_are_not_cut_away(tmp_path):
    ends = record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    spoil(path, path.read_bytes().index(b"zstd") + 40)
    data = path.read_bytes()
    with pytest.raises(DataError, match="cannot be read"):
        messages(tmp_path / "bag")
    assert path.read_bytes()[: ends[-1]] == data


def test_records_of_applications_are_passed_by(tmp_path):
    (end, *_) = record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    data = path.read_bytes()
    private = b"\x80" + (3).to_bytes(8, "little") + b"own"
    path.write_bytes(data[:end] + private + data[end:] + private)
    assert messages(tmp_path / "bag") == list(range(30))
    assert path.read_bytes().count(private) == 2


def test_what_follows_the_last_chunk_is_kept(tmp_path):
    record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    with path.open("ab") as file:
        builder = RecordBuilder()
        Metadata("told", {"by": "another"}).write(builder)
        file.write(builder.end())
    assert messages(tmp_path / "bag") == list(range(30))
    with path.open("rb") as file:
        assert [each.name for each in NonSeekingReader(file).iter_metadata()] == ["told"]


@pytest.mark.parametrize(
    ("packed", "sentence"),
    [
        (b"\x04\0\0\0zstx", "its chunk at byte .* is compressed as 'zstx'; known are '', 'lz4', 'zstd'"),
        (b"", "its chunk at byte .* unpacks to 300 MiB; at most 256 MiB are read"),
    ],
)
def test_a_chunk_that_is_not_read_here_is_not_cut_away(tmp_path, packed, sentence):
    record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    data = path.read_bytes()
    at = data.index(b"\x04\0\0\0zstd")
    size = at - 12  # times, size and checksum are before the name of the compression
    told = data[size : size + 8] if packed else (300 * 2**20).to_bytes(8, "little")
    data = data[:size] + told + data[size + 8 : at] + (packed or data[at : at + 8]) + data[at + 8 :]
    path.write_bytes(data)
    with pytest.raises(DataError, match=sentence):
        complete_bag(tmp_path / "bag")
    assert path.read_bytes() == data


def test_a_complete_bag_is_not_touched(tmp_path):
    record(tmp_path / "bag")
    before = (tmp_path / "bag" / "bag.mcap").read_bytes()
    complete_bag(tmp_path / "bag")
    assert (tmp_path / "bag" / "bag.mcap").read_bytes() == before
    metadata = (tmp_path / "bag" / "metadata.yaml").read_bytes()
    complete_bag(tmp_path / "bag")
    assert (tmp_path / "bag" / "metadata.yaml").read_bytes() == metadata


def test_a_bag_that_is_being_recorded_is_left_alone(tmp_path):
    record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    before = path.read_bytes()
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(DataError, match="is being recorded"):
            complete_bag(tmp_path / "bag")
    assert path.read_bytes() == before


def test_a_file_of_another_recorder_is_left_alone_while_it_may_be_written(tmp_path, monkeypatch):
    record(tmp_path / "bag", end=False, library="another")
    path = tmp_path / "bag" / "bag.mcap"
    before = path.read_bytes()
    with pytest.raises(DataError, match="was written less than 5 s ago, perhaps by a recorder that still runs"):
        open_bag(path)
    os.utime(path, (0, 0))

    def scan_while_it_grows(name, file):
        contents = scan(name, file)
        with path.open("ab") as recorder:
            recorder.write(b"x")
        return contents

    scan = bag_files.scan
    with monkeypatch.context() as grows:
        grows.setattr(bag_files, "scan", scan_while_it_grows)
        with pytest.raises(DataError, match="is being recorded"):
            open_bag(path)
    assert path.read_bytes() == before + b"x"
    os.utime(path, (0, 0))
    assert messages(tmp_path / "bag") == list(range(30))


def test_a_record_that_is_too_large_to_be_read_is_not_cut_away(tmp_path):
    """An attachment, say; the file has holes in its place."""
    record(tmp_path / "bag", end=False)
    path = tmp_path / "bag" / "bag.mcap"
    size, length = path.stat().st_size, 2**30 + 2**20
    with path.open("ab") as file:
        file.write(b"\x09" + length.to_bytes(8, "little"))
        file.truncate(size + 9 + length)
    with pytest.raises(DataError, match=f"its record at byte {size} has 1025 MiB; at most 1024 are read"):
        complete_bag(tmp_path / "bag")
    assert path.stat().st_size == size + 9 + length


@pytest.mark.parametrize("named", ["folder", "file"])
@pytest.mark.parametrize(
    "left_out",
    [
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.CHUNK, "repeat_channels": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"use_statistics": False},
        {"use_statistics": False, "index_types": IndexType.CHUNK},
        {"index_types": IndexType.MESSAGE},
        {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
        {"use_chunking": False},
    ],
    ids=str,
)
def test_all_messages_are_read_whatever_the_index_leaves_out(tmp_path, left_out, named):
    record(tmp_path / "bag", library="another", left_out=left_out)
    path = tmp_path / "bag" / "bag.mcap"
    before = path.read_bytes()
    with closing(open_bag(path if named == "file" else path.parent)) as reader:
        assert {each.topic: (each.msgtype, each.msgcount) for each in reader.connections} == {
            "/a": (STRING, 15),
            "/b": (STRING, 15),
        }
        assert [data[4] for _, _, data in reader.messages()] == list(range(30))
        second = [each for each in reader.connections if each.topic == "/b"]
        assert [data[4] for _, _, data in reader.messages(second, start=1010)] == list(range(11, 30, 2))
        assert (reader.start_time, reader.end_time, reader.message_count) == (1000, 1030, 30)
    assert path.read_bytes() == before


def test_messages_that_lie_one_by_one_in_another_order_are_read_in_that_of_their_times(tmp_path):
    """As ``ros2 bag record --storage-preset-profile fastwrite`` has them."""
    path = tmp_path / "fast.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(profile="ros2", library="another")
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for number in (2, 0, 1, 5, 4, 3, 4):
            writer.add_message(channels[number % 2], 1000 + number, bytes([0, 1, 0, 0, number]), 0)
        writer.finish()
    with closing(open_bag(path)) as reader:
        assert [data[4] for _, _, data in reader.messages()] == [0, 1, 2, 3, 4, 4, 5]
        second = [each for each in reader.connections if each.topic == "/b"]
        found = [(each.topic, at, data[4]) for each, at, data in reader.messages(second, start=1001, stop=1005)]
        assert found == [("/b", 1001, 1), ("/b", 1003, 3)]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "has no message"),
        (MAGIC[:5], "has no message"),
        (b"\x89PNG\r\n", "is no MCAP file"),
        (b"x" * 100, "is no MCAP file"),
    ],
)
def test_what_is_no_recording_is_said(tmp_path, content, sentence):
    (tmp_path / "bag").mkdir()
    path: Path = tmp_path / "bag" / "bag.mcap"
    path.write_bytes(content)
    with pytest.raises(DataError, match=sentence):
        complete_bag(tmp_path / "bag")
    assert path.read_bytes() == content


def numbers(bag):
    with closing(open_bag(bag)) as reader:
        return [data[-1] for _, _, data in reader.messages()]


def of_rosbags(folder, plugin):
    """A bag of twenty messages, as ``rosbags`` writes one."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(folder, version=9, storage_plugin=plugin) as writer:
        chat = writer.add_connection("/chat", STRING, typestore=store)
        for number in range(20):
            writer.write(chat, 1000 + number, bytes([0, 1, 0, 0, number]))
    return folder


@pytest.mark.parametrize("mode", ["WAL", "PERSIST"])
@pytest.mark.parametrize("named", ["folder", "file"])
def test_what_sqlite_keeps_beside_the_file_of_a_killed_recorder_is_read(tmp_path, mode, named):
    bag = of_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    shutil.copytree(bag, tmp_path / "alive")
    with closing(sqlite3.connect(tmp_path / "alive" / file.name, isolation_level=None)) as recorder:
        recorder.execute(f"PRAGMA journal_mode={mode}")
        recorder.execute("PRAGMA wal_autocheckpoint=0")
        recorder.execute("PRAGMA cache_size=1")  # so that a transaction that goes on is in the file in part
        add = "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)"
        for number in range(20, 30):
            recorder.execute(add, (1000 + number, bytes([0, 1, 0, 0, number])))
        recorder.execute("BEGIN")
        recorder.executemany(add, [(2000, bytes(100))] * 1000)
        shutil.rmtree(bag)
        shutil.copytree(tmp_path / "alive", bag)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    assert any(name.endswith(("-wal", "-journal")) for name in before)
    assert numbers(bag if named == "folder" else file) == list(range(30))
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_a_log_that_cannot_be_taken_up_is_named(tmp_path, monkeypatch):
    bag = of_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    file.with_name(f"{file.name}-wal").write_bytes(b"log")

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(
        DataError, match=f"completed from {file.name}-wal, left by its recorder: no space left on device"
    ):
        open_bag(bag)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_metadata_that_do_not_tell_the_kind_of_their_files_are_read_as_the_files_are(tmp_path, plugin):
    bag = of_rosbags(tmp_path / "bag", plugin)
    metadata = (bag / "metadata.yaml").read_text()
    told = f"storage_identifier: {plugin.name.lower()}"
    assert told in metadata
    (bag / "metadata.yaml").write_text(metadata.replace(told, 'storage_identifier: ""'))
    assert numbers(bag) == list(range(20))
