"""Bags that are cut, spoilt, foreign, or of types that changed: one sentence from all that works on a bag."""

import re
import shutil
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from im_bag import BagReader, BagWriter, Delivery
from im_bag import writer as bag_writer
from im_bag.files import METADATA
from im_bag.reading import messages_of
from im_bag.ros import replay
from im_core.errors import DataError
from im_pnt_analysis.cli import main as pnt
from im_pnt_node.ros import rerun
from im_vss.ros import recalibrate

RECORDED = Path(__file__).parent / "data" / "bags" / "faults"


def replayed(bag, monkeypatch, *options):
    monkeypatch.setattr("sys.argv", ["replay", bag, "--rate", "1000", *options])
    return replay.main()


TOOLS = {
    "replay": replayed,
    "recalibrate": lambda bag, _: recalibrate.main(["--recalibrate", bag]),
    "mission": lambda bag, _: rerun.main([bag]),
    "report": lambda bag, _: pnt(["bag", bag]),
    "display": lambda bag, _: pnt(["display", bag, "--port", "0"]),
    "fit": lambda bag, _: pnt(["fit", bag]),
}


def copied(folder):
    """A copy of a recording, and its only file."""
    shutil.copytree(RECORDED, folder / "bag")
    (part,) = (folder / "bag").glob("*.mcap")
    return part


def cut_copy(folder):
    part = copied(folder)
    part.write_bytes(part.read_bytes()[: part.stat().st_size // 2])
    return part.parent


def without_a_message(folder):
    part = copied(folder)
    part.write_bytes(part.read_bytes()[:5])
    (part.parent / METADATA).unlink()
    return part.parent


def spoilt(folder):
    """The first chunk does not have the checksum that it tells: of a byte within, the decompression may say more."""
    part = copied(folder)
    data = bytearray(part.read_bytes())
    at = 8  # behind the magic bytes; a record is its kind, its length and that
    while data[at] != Opcode.CHUNK:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[at + 9 + 24] ^= 0xFF  # behind the times of its first and last message and its size
    part.write_bytes(data)
    return part.parent


def without_its_file(folder):
    part = copied(folder)
    part.unlink()
    return part.parent


def without_metadata(folder):
    store, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String"
    with RosbagsWriter(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        writer.add_connection("/chat", kind, typestore=store)
    (folder / "bag" / METADATA).unlink()
    return folder / "bag"


def of_other_yaml(folder):
    (folder / "net.yaml").write_text("net: a\n")
    return folder


def of_ros_1(folder):
    (folder / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(4096))
    return folder / "old.bag"


def folder_of_ros_1(folder):
    return of_ros_1(folder).parent


def of_json(folder):
    (folder / "bag").mkdir()
    with (folder / "bag" / "bag.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/pnt/firings", "json", schema), 1, b"{}", 1)
        writer.finish()
    return folder / "bag"


def written(path, type_format, message_format):
    """A file of ROS 2 by its profile, with a topic of another type definition or serialisation."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", type_format, b"string data\n")
        writer.add_message(writer.register_channel("/chatter", message_format, schema), 1, b'{"data": "x"}', 1)
        writer.finish()
    return path


def file_of_json(folder):
    return written(folder / "bag.mcap", "ros2msg", "json")


def file_of_protobuf(folder):
    return written(folder / "bag.mcap", "protobuf", "protobuf")


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (cut_copy, "lacks its end, as a copy that was broken off; copy it again, or remove metadata.yaml"),
        (without_a_message, "has no message: the recording ended before the first was written"),
        (without_its_file, "Some database files are missing"),
        (without_metadata, "lacks metadata.yaml; name one of its files: bag.db3"),
        (of_other_yaml, "there is no bag in it"),
        (of_ros_1, "is a bag of ROS 1, of which rosbags-convert makes one of ROS 2"),
        (folder_of_ros_1, "old.bag is one of ROS 1, of which rosbags-convert makes one of ROS 2"),
        (of_json, "Serialization format {'json'} is not supported"),
        (file_of_json, "Serialization format {'json'} is not supported"),
        (file_of_protobuf, "Type definition format 'protobuf' is not supported: of ROS 2 are ros2msg and ros2idl"),
    ],
)
def test_what_is_no_bag_is_said_by_all(tmp_path, monkeypatch, capsys, tool, make, sentence):
    bag = make(tmp_path)
    files = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert TOOLS[tool](str(bag), monkeypatch) == 2
    (said,) = [line for line in capsys.readouterr().err.splitlines() if line]
    assert sentence in said
    made = {path for path in tmp_path.rglob("*") if path.is_file() and path.name != METADATA}
    assert {path: path.read_bytes() for path in made} == {path: files[path] for path in files if path.name != METADATA}


@pytest.mark.parametrize("tool", sorted(TOOLS.keys() - {"recalibrate"}))  # the recording has no calibration
def test_spoilt_bytes_are_met_with_a_sentence(tmp_path, monkeypatch, capsys, tool):
    bag = spoilt(tmp_path)
    assert TOOLS[tool](str(bag), monkeypatch) == 2
    assert "cannot be read: Chunk checksum mismatch" in capsys.readouterr().err


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize(
    ("tool", "sentence"),
    [
        ("recalibrate", "it holds no calibration, there is no topic /vss/calibrate/_service_event in it"),
        ("mission", "it is no recording of a machine of ours"),
        ("report", "there is no topic '/pnt/firings' in it (known: /chatter)"),
        ("display", "there is no topic '/pnt/firings' in it (known: /chatter)"),
        ("fit", "there is no topic '/pnt/firings' in it (known: /chatter)"),
    ],
)
def test_what_others_have_recorded_has_no_mission(tmp_path, monkeypatch, capsys, plugin, tool, sentence):
    kind, store = "std_msgs/msg/String", get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        chatter = writer.add_connection("/chatter", kind, typestore=store)
        writer.write(chatter, 1, store.serialize_cdr(store.types[kind](data="x"), kind))
    assert TOOLS[tool](str(tmp_path / "bag"), monkeypatch) == 2
    assert sentence in capsys.readouterr().err


def rewritten(folder, monkeypatch, change):
    """The recording with other definitions: ``change`` gets topic, type, hash and definition."""
    define = bag_writer.full_definition
    out = BagWriter(folder / "bag")
    with BagReader(RECORDED) as bag:
        for topic, kind in bag.types.items():
            kind, told_hash, definition = change(topic, kind, bag.hashes[topic], define(kind))
            monkeypatch.setattr(bag_writer, "full_definition", lambda _, made=definition: made)
            out.add_topic(topic, kind, bag.deliveries[topic], told_hash)
        for topic, stamp_ns, data in bag.messages(bag.types):
            out.write(topic, stamp_ns, data)
    out.close()
    return folder / "bag"


def changed(topic, kind, told_hash, definition):
    if topic != "/pnt/firings":
        return kind, told_hash, definition
    return kind, "RIHS01_" + "0" * 64, definition._replace(text=definition.text.replace("duration", "lasted"))


def undefined(topic, kind, told_hash, definition):
    return kind, told_hash, definition._replace(text="") if topic == "/pnt/firings" else definition


def garbled(topic, kind, told_hash, definition):
    return kind, told_hash, definition._replace(text="float64 n t\n%%\n") if topic == "/pnt/firings" else definition


def of_others(topic, kind, told_hash, definition):
    return "their_msgs/msg/Firing" if topic == "/pnt/firings" else kind, told_hash, definition


@pytest.mark.parametrize("tool", ["report", "display", "fit"])
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (changed, "im_msgs/msg/Firing is defined there without 'duration': it was recorded with another version of"),
        (undefined, "there is no definition of im_msgs/msg/Firing in it, by which /pnt/firings could be read"),
        (garbled, "the definition of im_msgs/msg/Firing, the type of /pnt/firings, cannot be read"),
        (of_others, "topic '/pnt/firings' is their_msgs/msg/Firing, not im_msgs/msg/Firing"),
    ],
)
def test_types_that_changed_or_are_not_defined_are_named(tmp_path, monkeypatch, capsys, tool, change, sentence):
    bag = rewritten(tmp_path, monkeypatch, change)
    assert TOOLS[tool](str(bag), monkeypatch) == 2
    assert sentence in capsys.readouterr().err


def test_what_is_replayed_is_of_the_types_that_are_here(tmp_path, monkeypatch, capsys):
    bag = rewritten(tmp_path, monkeypatch, changed)
    assert replayed(str(bag), monkeypatch) == 2
    assert "im_msgs/msg/Firing has another definition here than when it was recorded" in capsys.readouterr().err


def changed_without_hash(topic, kind, told_hash, definition):
    return kind, "", changed(topic, kind, told_hash, definition)[2]


@pytest.mark.parametrize("change", [changed, changed_without_hash])
@pytest.mark.parametrize("named", ["folder", "file"])
def test_a_type_that_changed_is_not_replayed_whatever_tells_it(tmp_path, monkeypatch, capsys, change, named):
    bag = rewritten(tmp_path, monkeypatch, change)
    if named == "file":
        (bag / METADATA).unlink()
    assert replayed(str(bag if named == "folder" else bag / "bag.mcap"), monkeypatch) == 2
    assert "im_msgs/msg/Firing has another definition here than when it was recorded" in capsys.readouterr().err


def without_hash(topic, kind, told_hash, definition):
    """As of publishers that tell none."""
    return kind, "INVALID", definition


def without_either(topic, kind, told_hash, definition):
    return kind, "", undefined(topic, kind, told_hash, definition)[2]


@pytest.mark.parametrize("change", [without_hash, without_either])
def test_what_tells_no_hash_is_replayed_unless_its_definition_is_another(tmp_path, monkeypatch, change):
    bag = rewritten(tmp_path, monkeypatch, change)
    with BagReader(bag) as reader:
        assert not any(reader.hashes.values())
        for topic in reader.types:
            reader.check_definition(topic)
    with BagReader(RECORDED) as recorded, BagReader(bag / "bag.mcap") as reader:
        assert (reader.types, reader.counts) == (recorded.types, recorded.counts)


def of_two_types(folder):
    """A topic that has a second type in a second part, beside one of a single type."""
    store = get_typestore(Stores.ROS2_JAZZY)
    (folder / "bag").mkdir()
    for number, changing in enumerate([("std_msgs/msg/String", "x"), ("std_msgs/msg/Char", 1)]):
        with (folder / "bag" / f"bag_{number}.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2")
            for topic, (kind, data) in {"/changing": changing, "/chatter": ("std_msgs/msg/String", "y")}.items():
                definition = store.generate_msgdef(kind, ros_version=2)[0].encode()
                channel = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", definition))
                message = store.serialize_cdr(store.types[kind](data=data), kind)
                writer.add_message(channel, 1 + number, bytes(message), 1)
            writer.finish()
    return folder / "bag"


def test_a_topic_of_several_types_is_left_out_or_refused(tmp_path, monkeypatch, capsys):
    bag = of_two_types(tmp_path)
    sentence = f"/changing has several types in {bag}: std_msgs/msg/Char, std_msgs/msg/String"
    with BagReader(bag) as reader:
        assert reader.counts == {"/changing": 2, "/chatter": 2}
        assert replay.known_topics(reader, list(reader.types), {}, named=False) == ["/chatter"]
        assert f"replay: /changing is left out: {sentence}" in capsys.readouterr().err
        assert [stamp for _, stamp, _ in reader.messages(["/chatter"])] == [1, 2]
        with pytest.raises(DataError, match="/changing has several types"):
            next(reader.messages(["/chatter", "/changing"]))
    monkeypatch.setattr("sys.argv", ["replay", str(bag), "--topics", "/changing"])
    assert replay.main() == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    ("topic", "sentence"), [("/changing", "several types"), ("/pnt/firings", "another definition")]
)
def test_what_is_not_replayed_is_not_extracted(tmp_path, monkeypatch, capsys, topic, sentence):
    bag = of_two_types(tmp_path) if topic == "/changing" else rewritten(tmp_path, monkeypatch, changed)
    monkeypatch.setattr("sys.argv", ["replay", str(bag), "--extract", str(tmp_path / "small"), "--topics", topic])
    assert replay.main() == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "small").exists()


@pytest.mark.parametrize("described", [True, False])
def test_a_type_of_several_definitions_is_not_read_by_one_of_them(tmp_path, described):
    """The metadata of others name a topic once."""
    with BagReader(RECORDED) as bag:
        delivery, moments = bag.deliveries["/pnt/firings"], list(bag.messages(["/pnt/firings"]))
    for number in range(2):
        out = BagWriter(tmp_path / f"bag_{number}")
        out.add_topic("/pnt/firings", "im_msgs/msg/Firing", delivery, f"RIHS01_{number:064}")
        for _, stamp_ns, data in moments:
            out.write("/pnt/firings", stamp_ns + number * 10**12, data)
        out.close()
    bag = tmp_path / "bag_0"
    shutil.copy(tmp_path / "bag_1" / "bag_1.mcap", bag)
    if described:
        listed = (bag / METADATA).read_text()
        (bag / METADATA).write_text(listed.replace("- bag_0.mcap\n", "- bag_0.mcap\n  - bag_1.mcap\n", 1))
    with BagReader(bag) as reader, pytest.raises(DataError, match="several definitions of im_msgs/msg/Firing"):
        next(reader.messages(["/pnt/firings"]))
    with pytest.raises(DataError, match="several definitions of im_msgs/msg/Firing in it"):
        next(messages_of(bag, {"/pnt/firings": ("im_msgs/msg/Firing",)}))


def test_a_file_without_metadata_is_taken_by_itself(tmp_path, monkeypatch):
    """What lies beside it may be of other bags: it is neither completed nor counted in."""
    part = copied(tmp_path)
    (part.parent / METADATA).unlink()
    other = part.with_name("other.mcap")
    other.write_bytes(part.read_bytes()[: part.stat().st_size * 9 // 10])
    with BagReader(part) as bag:
        assert sum(bag.counts.values()) > 1000
    assert other.stat().st_size == part.stat().st_size * 9 // 10
    assert not (part.parent / METADATA).exists()


def with_a_foreign_name(folder):
    """A bag with a topic whose name ROS 2 does not allow, and one whose name it does."""
    writer = BagWriter(folder / "bag")
    for number, topic in enumerate(("/cam-1/text", "/text")):
        writer.add_topic(topic, "std_msgs/msg/String", Delivery(True, False, 1))
        writer.write(topic, 5 + number, b"\0\1\0\0\2\0\0\0x\0")
    writer.close()
    return str(folder / "bag")


def test_topics_with_names_that_ros_does_not_allow_are_left_out(tmp_path, monkeypatch, capsys):
    bag = with_a_foreign_name(tmp_path)
    assert replayed(bag, monkeypatch) == 0
    told = capsys.readouterr()
    sentence = "/cam-1/text is no full name of a topic: .*; --remap /cam-1/text:=/NEW gives it another\n"
    assert re.fullmatch(f"replay: /cam-1/text is left out: {sentence}", told.err)
    assert "replay: 1 messages published" in told.out
    assert replayed(bag, monkeypatch, "--topics", "/cam-1/text") == 2
    assert re.fullmatch(f"replay: {sentence}", capsys.readouterr().err)
    assert replayed(bag, monkeypatch, "--remap", "/cam-1/text:=/cam_1/text") == 0
    assert "replay: 2 messages published" in capsys.readouterr().out


def test_new_names_that_ros_does_not_allow_are_refused(tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit, match="2"):
        replayed(with_a_foreign_name(tmp_path), monkeypatch, "--remap", "/text:=/9x")
    assert "error: --remap /text:=/9x: /9x is no full name of a topic: " in capsys.readouterr().err


def of_texts(folder, *topics, kind="std_msgs/msg/String"):
    """A bag of another recorder with a message on each topic."""
    with (folder / "bag.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", b"string data\n")
        for topic in topics:
            writer.add_message(writer.register_channel(topic, "cdr", schema), 5, b"\0\1\0\0\2\0\0\0x\0", 5)
        writer.finish()
    return str(folder / "bag.mcap")


def test_a_name_at_which_another_type_is_published_is_said(tmp_path, monkeypatch, capsys):
    bag = of_texts(tmp_path, "/rosout")  # each node has one
    assert replayed(bag, monkeypatch) == 2
    sentence = "cannot be of std_msgs/msg/String: this replay publishes another type there; --remap"
    assert f"replay: /rosout {sentence} /rosout:=/NEW gives it another name\n" in capsys.readouterr().err
    assert replayed(bag, monkeypatch, "--remap", "/rosout:=/said") == 0
    capsys.readouterr()
    assert replayed(str(of_two_types(tmp_path)), monkeypatch, "--remap", "/chatter:=/parameter_events") == 2
    assert f"replay: /chatter as /parameter_events {sentence} /chatter:=/NEW" in capsys.readouterr().err


def test_a_topic_of_a_type_of_no_messages_is_left_out(tmp_path, monkeypatch, capsys):
    assert replayed(of_texts(tmp_path, "/chat", kind="std_srvs/srv/Trigger"), monkeypatch) == 2
    assert "/chat is left out: std_srvs/srv/Trigger is no type of messages, but that of" in capsys.readouterr().err


def test_a_new_name_that_has_no_effect_is_refused(tmp_path, monkeypatch, capsys):
    bag = of_texts(tmp_path, "/chat", "/say/_service_event")
    for topic, options in (("/say/_service_event", []), ("/chat", ["--topics", "/say/_service_event"])):
        assert replayed(bag, monkeypatch, "--remap", f"{topic}:=/new", *options) == 2
        assert f"--remap {topic} is not replayed; give it in --topics" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        replayed(bag, monkeypatch, "--remap", "/chat:=/one", "/chat:=/two")
    assert "--remap gives /chat two names, /one and /two" in capsys.readouterr().err


def test_half_a_bag_is_not_extracted(tmp_path, monkeypatch, capsys):
    bag = spoilt(tmp_path)
    monkeypatch.setattr("sys.argv", ["replay", str(bag), "--extract", str(tmp_path / "small")])
    assert replay.main() == 2
    assert "cannot be read: Chunk checksum mismatch" in capsys.readouterr().err
    assert not (tmp_path / "small").exists()
