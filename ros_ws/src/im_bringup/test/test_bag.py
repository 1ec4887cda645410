import pytest

from im_bringup import bag
from im_bringup.bag import BagReader, BagWriter, Delivery, chosen_topics
from im_core.errors import DataError


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
