import pytest

from im_bringup import bag
from im_bringup.bag import BagReader, BagWriter, Delivery, PartLimits, chosen_topics
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
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))


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


def test_a_recorder_that_is_killed_loses_only_the_part_it_was_writing(tmp_path):
    written_in_parts(tmp_path / "bag", PartLimits(size_bytes=300), count=8)  # and never closed
    with BagReader(tmp_path / "bag") as reader:
        assert sum(reader.counts.values()) == 6


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
    with pytest.raises(DataError, match="cannot be made"):
        BagWriter(tmp_path)
    with pytest.raises(DataError, match="is not a bag that can be read"):
        BagReader(tmp_path)
    with pytest.raises(DataError, match="is not a bag that can be read"):
        BagReader(tmp_path / "nothing")


def test_control_topics_are_replayed_only_by_name():
    topics = ["/im/phase", "/tf", "/joint_states", "/dispatcher/tokens"]
    assert chosen_topics(topics, []) == ["/joint_states", "/tf"]
    assert chosen_topics(topics, ["/im/phase"]) == ["/im/phase"]
    with pytest.raises(DataError, match="the bag has no topic /x; it has /dispatcher/tokens, /im/phase, "):
        chosen_topics(topics, ["/x"])


def test_bags_go_into_their_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("IM_ROOT", str(tmp_path))
    assert bag.default_folder("now") == tmp_path / "bags" / "now"
