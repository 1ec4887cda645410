import errno
import itertools
import multiprocessing
import os
import random
import shutil

import pytest
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

import im_bag
from im_bag import BagReader, BagWriter, Delivery, PartLimits, chosen_topics
from im_bag import writer as bag_writer
from im_bag.definitions import changed_types, full_definition
from im_bag.files import METADATA
from im_bag.reading import messages_of
from im_core.errors import DataError, StoreError


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    """An install prefix with two message types, one of which contains the other and a type of Jazzy."""
    folder = tmp_path / "prefix" / "share" / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Inner.msg").write_text("float64 x  # [m]\n")
    (folder / "Outer.msg").write_text(
        "std_msgs/Header header\nInner[] parts\nInner[2] two\nbuiltin_interfaces/Time[<=3] t\n"
    )
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"), prepend=os.pathsep)


def test_what_goes_in_comes_out(tmp_path, workspace):
    writer = BagWriter(tmp_path / "bag")
    latched = Delivery(reliable=True, latched=True, depth=1)
    sensor = Delivery(reliable=False, latched=False, depth=5)
    writer.add_topic("/a", "my_msgs/msg/Outer", latched)
    writer.add_topic("/b", "std_msgs/msg/String", sensor)
    for number in range(10):
        writer.write("/a" if number % 2 else "/b", 10**18 + number * 10**8, bytes([0, 1, 0, 0, number]))
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        assert reader.types == {"/a": "my_msgs/msg/Outer", "/b": "std_msgs/msg/String"}
        assert reader.counts == {"/a": 5, "/b": 5}
        assert reader.deliveries == {"/a": latched, "/b": sensor}
        assert reader.duration_s == pytest.approx(0.9)
        assert [data[4] for _, _, data in reader.messages(["/a", "/b"])] == list(range(10))
        assert [data[4] for _, _, data in reader.messages(["/a"])] == [1, 3, 5, 7, 9]


def test_a_public_reader_reads_it(tmp_path, workspace):
    from mcap.reader import make_reader

    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/a", "my_msgs/msg/Outer", Delivery(True, False, 1))
    writer.write("/a", 5, b"\0\1\0\0")
    writer.close()
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        ((schema, channel, message),) = make_reader(file).iter_messages()
    assert (schema.name, channel.topic, message.log_time) == ("my_msgs/msg/Outer", "/a", 5)
    assert "MSG: my_msgs/Inner" in schema.data.decode()


STRING = "std_msgs/msg/String"
RELIABLE = Delivery(reliable=True, latched=False, depth=10)


def written_in_parts(path, limits, count=9):
    """Messages of 100 bytes, one a second; the second topic appears with the third message."""
    writer = BagWriter(path, limits)
    writer.add_topic("/a", STRING, RELIABLE)
    for number in range(count):
        if number == 2:
            writer.add_topic("/b", STRING, RELIABLE)
        writer.write("/b" if number >= 2 and number % 2 else "/a", (1000 + number) * 10**9, bytes([number]) * 100)
    return writer


@pytest.mark.parametrize("limits", [PartLimits(size_bytes=300), PartLimits(time_ns=2 * 10**9)])
def test_a_bag_is_split_by_size_and_by_time_and_read_as_one(tmp_path, limits):
    writer = written_in_parts(tmp_path / "bag", limits)
    writer.write("/a", 1009 * 10**9, b"last")
    writer.close()
    files = sorted(path.name for path in (tmp_path / "bag").iterdir())
    assert files == ["bag.mcap", "bag_1.mcap", "bag_2.mcap", "bag_3.mcap", "metadata.yaml"]
    with BagReader(tmp_path / "bag") as reader:
        assert reader.counts == {"/a": 7, "/b": 3}
        assert reader.duration_s == pytest.approx(9.0)
        read = [(topic, data[:1]) for topic, _, data in reader.messages(["/a", "/b"])]
        assert [data for _, data in read] == [*(bytes([number]) for number in range(9)), b"l"]
        assert [topic for topic, _ in read[:4]] == ["/a", "/a", "/a", "/b"]


def write_until_killed(path, flushed):
    """Messages, ten a chunk and three chunks a part; tells how many have been flushed."""
    writer = BagWriter(path, PartLimits(size_bytes=3000))
    writer.add_topic("/a", STRING, RELIABLE)
    for number in itertools.count():
        writer.write("/a", 10**18 + number, number.to_bytes(4, "little") + bytes(96), 10**18 - number, number)
        if number % 10 == 9:
            writer.flush()
            flushed.value = number + 1


def test_a_recorder_that_is_killed_at_any_moment_keeps_all_that_was_flushed(tmp_path):
    choose = random.Random(15)
    fork = multiprocessing.get_context("fork")
    for number in range(12):
        flushed, enough = fork.Value("i", 0), choose.randrange(10, 400)
        child = fork.Process(target=write_until_killed, args=(tmp_path / f"bag{number}", flushed))
        child.start()
        while flushed.value < enough and child.is_alive():
            pass
        child.kill()
        child.join()
        with BagReader(tmp_path / f"bag{number}") as reader:
            read = [int.from_bytes(data[:4], "little") for _, _, data in reader.messages(["/a"])]
        assert read == list(range(len(read)))
        assert flushed.value <= len(read) <= flushed.value + 10


def test_a_part_that_is_being_recorded_is_not_opened_by_its_file(tmp_path):
    writer = written_in_parts(tmp_path / "bag", PartLimits())
    part = tmp_path / "bag" / "bag.mcap"
    with pytest.raises(DataError, match="is being recorded"):
        BagReader(part)
    writer.flush()
    before = part.read_bytes()
    with pytest.raises(DataError, match="is being recorded"):
        BagReader(part)
    assert part.read_bytes() == before
    writer.write("/a", 1009 * 10**9, b"last")
    writer.close()
    with BagReader(part) as reader:
        read = [data[:1] for _, _, data in reader.messages(["/a", "/b"])]
    assert read == [*(bytes([number]) for number in range(9)), b"l"]


def bag_of_parts(path, each=3):
    """Ten messages in parts."""
    writer = written_in_parts(path, PartLimits(size_bytes=100 * each))
    writer.write("/a", 1009 * 10**9, b"last")
    writer.close()
    return path


def first_bytes(path):
    with BagReader(path) as reader:
        return [data[0] for _, _, data in reader.messages(["/a", "/b"])]


def test_parts_are_in_the_order_of_their_messages_whatever_their_names(tmp_path):
    """A folder that was named anew: ``run_5.mcap`` is its first part, ``run_5_1.mcap`` its second."""
    path = bag_of_parts(tmp_path / "run_5").rename(tmp_path / "monday")
    (path / METADATA).unlink()
    assert first_bytes(path) == [*range(9), ord("l")]


def test_a_part_that_is_missing_is_named_before_another_is_listed(tmp_path):
    path = bag_of_parts(tmp_path / "bag")
    whole = (path / METADATA).read_text()
    (path / "bag_1.mcap").rename(tmp_path / "bag_1.mcap")
    (path / "bag_3.mcap").rename(path / "unlisted.mcap")
    with pytest.raises(DataError, match=r"lacks bag_1.mcap, bag_3.mcap, which metadata.yaml lists; put it back, or"):
        BagReader(path)
    assert (path / METADATA).read_text() == whole


@pytest.mark.parametrize("described", [True, False])
def test_a_copy_of_a_part_is_not_taken_as_another(tmp_path, described):
    path = bag_of_parts(tmp_path / "bag")
    shutil.copy(path / "bag_1.mcap", path / "before-bag_1.mcap")
    if not described:
        (path / METADATA).unlink()
    files = {file: file.read_bytes() for file in path.iterdir()}
    with pytest.raises(
        DataError, match=r"before-bag_1.mcap: does not belong to this bag; its time overlaps that of bag_1.mcap"
    ):
        BagReader(path)
    assert {file: file.read_bytes() for file in path.iterdir()} == files
    (path / "before-bag_1.mcap").unlink()
    assert first_bytes(path) == [*range(9), ord("l")]


def test_another_bag_of_the_same_time_is_not_taken_as_a_part(tmp_path):
    """One of one file, which begins within the first part and ends after the last."""
    path = bag_of_parts(tmp_path / "bag", each=5)
    other = BagWriter(tmp_path / "other")
    other.add_topic("/c", STRING, RELIABLE)
    for seconds in (1001, 1020):
        other.write("/c", seconds * 10**9, b"x")
    other.close()
    shutil.copy(tmp_path / "other" / "other.mcap", path)
    with pytest.raises(DataError, match=r"other.mcap: does not belong to this bag"):
        BagReader(path)
    (path / "other.mcap").unlink()
    assert first_bytes(path) == [*range(9), ord("l")]


def test_a_disk_that_is_full_leaves_whole_chunks_and_a_bag_that_opens(tmp_path, monkeypatch):
    writer = written_in_parts(tmp_path / "bag", PartLimits(), count=4)
    writer.flush()
    with monkeypatch.context() as full:

        def write_half(file, data):
            if len(data) < 2:
                raise OSError(errno.ENOSPC, "No space left on device")
            return write(file, data[: len(data) // 2])

        write = os.write
        full.setattr(os, "write", write_half)
        writer.write("/a", 1004 * 10**9, b"lost")
        with pytest.raises(StoreError, match="No space left on device"):
            writer.flush()
        with pytest.raises(StoreError, match="No space left on device"):
            writer.write("/a", 1005 * 10**9, b"refused")
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        assert [data[0] for _, _, data in reader.messages(["/a", "/b"])] == [0, 1, 2, 3]


def nothing_written(file, data):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_is_full_from_the_first_message_on_is_said_once(tmp_path, monkeypatch):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/a", STRING, RELIABLE)
    writer.write("/a", 5, b"lost")
    with monkeypatch.context() as full:
        full.setattr(os, "write", nothing_written)
        with pytest.raises(StoreError, match="No space left on device"):
            writer.flush()
    writer.close()
    with pytest.raises(DataError, match="has no message: the recording ended before the first was written"):
        BagReader(tmp_path / "bag")


def test_a_folder_that_is_removed_ends_the_recording(tmp_path):
    writer = written_in_parts(tmp_path / "bag", PartLimits(), count=4)
    shutil.rmtree(tmp_path / "bag")
    with pytest.raises(StoreError, match=f"{tmp_path / 'bag'} cannot be written: .*No such file"):
        writer.flush()
    with pytest.raises(StoreError, match="No such file"):
        writer.close()


def test_a_part_that_cannot_be_begun_leaves_those_before_it(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    writer = written_in_parts(tmp_path / "bag", PartLimits(size_bytes=300), count=2)
    with monkeypatch.context() as full:
        full.setattr(bag_writer, "_PartFile", refuse)
        with pytest.raises(StoreError, match="No space left on device"):
            writer.write("/a", 1002 * 10**9, bytes([2]) * 100)
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        assert [data[0] for _, _, data in reader.messages(["/a"])] == [0, 1, 2]


def test_a_clock_that_is_set_back_keeps_the_order_of_arrival(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/a", STRING, RELIABLE)
    for number, second in enumerate((10, 11, 12, 6, 7, 8, 14)):
        writer.write("/a", second * 10**9, bytes([number]))
        writer.flush()
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        read = [(stamp_ns // 10**9, data[0]) for _, stamp_ns, data in reader.messages(["/a"])]
    assert read == [(10, 0), (11, 1), (12, 2), (12, 3), (12, 4), (12, 5), (14, 6)]


def test_a_message_has_the_time_and_the_number_of_its_source(tmp_path):
    from mcap.reader import make_reader

    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/a", STRING, RELIABLE, "RIHS01_0")
    writer.write("/a", 7, b"\0\1\0\0", published_ns=5, sequence=42)
    writer.close()
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        ((_, channel, message),) = make_reader(file).iter_messages()
    assert (message.log_time, message.publish_time, message.sequence) == (7, 5, 42)
    assert channel.metadata["topic_type_hash"] == "RIHS01_0"


def test_the_event_of_a_service_is_decoded_from_the_bag_alone(tmp_path):
    name = "std_srvs/srv/SetBool_Event"
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/light/_service_event", name, RELIABLE)
    request = b"\1\0\0\0\1" + bytes(3)
    writer.write("/light/_service_event", 7, b"\0\1\0\0" + b"\3" + bytes(39) + request + bytes(4))
    writer.close()
    (event,) = messages_of(tmp_path / "bag", {"/light/_service_event": (name,)})
    assert event.content.info.event_type == 3
    assert [each.data for each in event.content.request] == [True]
    assert not event.content.response


@pytest.mark.parametrize(
    "name", ["std_srvs/srv/SetBool_Event", "std_srvs/srv/Empty_Event", "sensor_msgs/msg/Image", "std_msgs/msg/Empty"]
)
def test_a_definition_is_the_same_here_as_a_message_and_in_idl(name):
    encoding, text = full_definition(name)
    form = MessageDefinitionFormat.MSG if encoding == "ros2msg" else MessageDefinitionFormat.IDL
    assert not changed_types(name, MessageDefinition(form, text))
    fields = "octet data; uint8 more;" if "Image" in name else "uint8 structure_needs_at_least_one_member;"
    module, kind, own = name.split("/")
    other = f"module {module} {{ module {kind} {{ struct {own} {{ {fields} }}; }}; }};\n"
    changed = changed_types(name, MessageDefinition(MessageDefinitionFormat.IDL, other))
    assert changed == ([] if own == "Empty" else [name])


def test_a_recording_ends_before_the_disk_is_full_and_is_whole(tmp_path):
    writer = BagWriter(tmp_path / "bag", PartLimits(free_bytes=2**60))
    writer.add_topic("/a", STRING, RELIABLE)
    with pytest.raises(StoreError, match=r"is not written any longer: .* MiB are free on the disk"):
        writer.write("/a", 5, bytes(2**20))
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        assert reader.counts == {"/a": 1}


def test_an_unknown_type_is_named(tmp_path, workspace):
    writer = BagWriter(tmp_path / "bag")
    with pytest.raises(DataError, match="the type my_msgs/msg/Other is not defined in any sourced workspace"):
        writer.add_topic("/a", "my_msgs/msg/Other", Delivery(True, False, 1))
    writer.close()


def test_folders_that_are_there_or_are_no_bags_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"cannot be made: File exists$"):
        BagWriter(tmp_path)
    with pytest.raises(DataError, match="is not a bag that can be read"):
        BagReader(tmp_path)
    with pytest.raises(DataError, match="is not a bag that can be read"):
        BagReader(tmp_path / "nothing")


def test_control_topics_are_replayed_only_by_name():
    moving = ["/left/command/setpoints", "/left/command/torques", "/right/joint_trajectory"]
    topics = ["/im/phase", "/tf", "/joint_states", "/dispatcher/tokens", *moving]
    assert chosen_topics(topics, moving) == moving
    assert chosen_topics(topics, []) == ["/joint_states", "/tf"]
    assert chosen_topics(topics, ["/im/phase"]) == ["/im/phase"]
    with pytest.raises(DataError, match=r"the bag has no topic /x \(known: /dispatcher/tokens, /im/phase, "):
        chosen_topics(topics, ["/x"])


def test_bags_go_into_their_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("IM_ROOT", str(tmp_path))
    assert im_bag.default_folder("now") == tmp_path / "bags" / "now"
