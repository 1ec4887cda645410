"""Bags as other tools expect them: metadata of rosbag2 (version 9), MCAP with profile ros2, definitions that are whole.

No ``ros2 bag`` can be run here, and no Foxglove. Asserted is what they read: ``rosbag2_storage/yaml.hpp`` and the MCAP
plugin of Jazzy, and the specification of MCAP with its registry (profile ros2, schema encodings ros2msg and ros2idl).
"""

import functools
import io
import json
import re
from typing import Annotated, Literal

import pydantic
import pytest
import yaml
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, MessageIndex, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_idl, get_typestore

from im_bag import BagReader, BagWriter, Delivery, PartLimits
from im_bag.definitions import full_definition
from im_bag.files import METADATA, complete_bag
from im_bag.reading import messages_of
from im_core.executables import prefixes

EVENT = "im_msgs/srv/SpotFind_Event"
TOPICS = {
    "/said": ("std_msgs/msg/String", Delivery(reliable=True, latched=True, depth=3)),
    "/tf": ("tf2_msgs/msg/TFMessage", Delivery(reliable=False, latched=False, depth=5)),
    "/vss/spot_find/_service_event": (EVENT, Delivery(reliable=True, latched=False, depth=10)),
}
PLAIN = [topic for topic, (kind, _) in TOPICS.items() if kind != EVENT]
STORE = get_typestore(Stores.ROS2_JAZZY)
HASHES = {topic: STORE.hash_rihs01(TOPICS[topic][0]) for topic in PLAIN}
EVENT_HASHES = {
    told["type_name"]: told["hash_string"]
    for prefix in prefixes()
    for kind in ("srv", "action")
    for file in sorted((prefix / "share").glob(f"*/{kind}/*.json"))
    for told in json.loads(file.read_text())["type_hashes"]
    if told["type_name"].endswith("_Event")
}
"""As the generators of ROS worked them out, of all services and actions of the sourced workspaces."""
HASHES["/vss/spot_find/_service_event"] = EVENT_HASHES[EVENT]
PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
PRIMITIVES |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
Natural = Annotated[int, pydantic.Field(ge=0, strict=True)]


class Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid")


class Seconds(Strict):
    sec: Natural
    nsec: Natural


class Qos(Strict):
    history: Literal["keep_last", "keep_all"]
    depth: Natural
    reliability: Literal["reliable", "best_effort"]
    durability: Literal["transient_local", "volatile"]
    deadline: Seconds
    lifespan: Seconds
    liveliness: Literal["automatic", "manual_by_topic"]
    liveliness_lease_duration: Seconds
    avoid_ros_namespace_conventions: pydantic.StrictBool


class TopicMetadata(Strict):
    name: str
    type: str
    serialization_format: Literal["cdr"]
    offered_qos_profiles: list[Qos]
    type_description_hash: Annotated[str, pydantic.Field(pattern="^RIHS01_[0-9a-f]{64}$")]


class TopicCount(Strict):
    topic_metadata: TopicMetadata
    message_count: Natural


class Duration(Strict):
    nanoseconds: Natural


class Start(Strict):
    nanoseconds_since_epoch: Natural


class File(Strict):
    path: str
    starting_time: Start
    duration: Duration
    message_count: Natural


class Metadata(Strict):
    version: Literal[9]
    storage_identifier: Literal["mcap"]
    duration: Duration
    starting_time: Start
    message_count: Natural
    topics_with_message_count: list[TopicCount]
    compression_format: Literal[""]
    compression_mode: Literal[""]
    relative_file_paths: list[str]
    files: list[File]
    custom_data: dict[str, str] | None
    ros_distro: Literal["jazzy"]


def message(topic, number):
    """Bytes of a message: a text, no transforms, or an event with neither request nor response."""
    if topic == "/said":
        return bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](data=f"n{number}"), "std_msgs/msg/String"))
    return bytes([0, 1, 0, 0]) + bytes(4 if topic == "/tf" else 48)


def write_bag(path, topics):
    """24 messages, one a second, on the topics in turn."""
    writer = BagWriter(path, PartLimits(time_ns=15 * 10**9))
    for topic in topics:
        writer.add_topic(topic, *TOPICS[topic], HASHES[topic])
    for number in range(24):
        topic = list(topics)[number % len(topics)]
        writer.write(topic, 10**18 + number * 10**9, message(topic, number), 10**18 + number, number + 1)
        if number % 5 == 4:
            writer.flush()
    writer.close()
    return path


@pytest.fixture(params=["closed", "killed"])
def bag(request, tmp_path):
    """A bag of two parts; where its recorder was killed, the last was completed."""
    write_bag(tmp_path / "bag", TOPICS)
    if request.param == "killed":
        last = tmp_path / "bag" / "bag_1.mcap"
        end = last.read_bytes().rindex(b"\x89MCAP0\r\n")
        with last.open("r+b") as file:
            file.truncate(end)
        (tmp_path / "bag" / METADATA).unlink()
        complete_bag(tmp_path / "bag")
    return tmp_path / "bag"


def parts(bag):
    return sorted(bag.glob("*.mcap"), key=lambda path: len(path.name))


def test_metadata_are_those_of_rosbag2_field_by_field(bag):
    told = Metadata.model_validate(yaml.safe_load((bag / METADATA).read_text())["rosbag2_bagfile_information"])
    assert told.relative_file_paths == [file.path for file in told.files] == ["bag.mcap", "bag_1.mcap"]
    assert (told.message_count, [file.message_count for file in told.files]) == (24, [16, 8])
    assert told.starting_time.nanoseconds_since_epoch == told.files[0].starting_time.nanoseconds_since_epoch == 10**18
    assert (told.duration.nanoseconds, told.files[1].duration.nanoseconds) == (23 * 10**9, 7 * 10**9)
    assert {each.topic_metadata.name: each.message_count for each in told.topics_with_message_count} == dict.fromkeys(
        TOPICS, 8
    )
    for each in told.topics_with_message_count:
        kind, delivery = TOPICS[each.topic_metadata.name]
        (qos,) = each.topic_metadata.offered_qos_profiles
        assert (each.topic_metadata.type, each.topic_metadata.type_description_hash) == (
            kind,
            HASHES[each.topic_metadata.name],
        )
        assert (qos.reliability == "reliable", qos.durability == "transient_local", qos.depth) == (
            delivery.reliable,
            delivery.latched,
            delivery.depth,
        )


def test_channels_tell_type_hash_and_delivery_as_the_metadata_do(bag):
    told = Metadata.model_validate(yaml.safe_load((bag / METADATA).read_text())["rosbag2_bagfile_information"])
    by_name = {each.topic_metadata.name: each.topic_metadata for each in told.topics_with_message_count}
    for part in parts(bag):
        with part.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert reader.get_header().profile == "ros2"
            summary = reader.get_summary()
        assert {channel.topic for channel in summary.channels.values()} == set(TOPICS)
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            assert channel.message_encoding == "cdr"
            assert schema.encoding == ("ros2idl" if schema.name == EVENT else "ros2msg")
            assert schema.name == by_name[channel.topic].type
            assert channel.metadata["topic_type_hash"] == by_name[channel.topic].type_description_hash
            profiles = [Qos.model_validate(each) for each in yaml.safe_load(channel.metadata["offered_qos_profiles"])]
            assert profiles == by_name[channel.topic].offered_qos_profiles


def test_definitions_hold_every_type_that_they_name(bag):
    with parts(bag)[0].open("rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
    for schema in schemas:
        if schema.encoding == "ros2idl":
            continue  # shown by the hash, which is one of all
        own, *others = re.split(r"^={80}\nMSG: ", schema.data.decode(), flags=re.MULTILINE)
        texts = {schema.name: own} | {text.split("\n", 1)[0]: text.split("\n", 1)[1] for text in others}
        for name, text in texts.items():
            for line in text.splitlines():
                words = line.partition("#")[0].split()
                if len(words) < 2:
                    continue
                kind = re.sub(r"(<=\d+)?(\[.*\])?$", "", words[0])
                package = name.split("/")[0]
                known = {kind, f"{package}/{kind}", kind.replace("/msg/", "/"), f"{package}/srv/{kind}"}
                assert kind in PRIMITIVES or known & texts.keys() or kind == "Header", f"{schema.name}: {line}"


def test_chunks_are_indexed_message_by_message_and_the_summary_counts_them(bag):
    for part in parts(bag):
        with part.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary, listed = reader.get_summary(), [each for *_, each in reader.iter_messages()]
        assert (
            summary.statistics.message_count == len(listed) == sum(summary.statistics.channel_message_counts.values())
        )
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) >= 2
        assert summary.statistics.message_start_time == min(each.log_time for each in listed)
        assert summary.statistics.message_end_time == max(each.log_time for each in listed)
        data, indexed = part.read_bytes(), set()
        for index in summary.chunk_indexes:
            assert index.compression == "zstd"
            (chunk,) = _records(data, index.chunk_start_offset, 1)
            assert isinstance(chunk, Chunk)
            assert (chunk.message_start_time, chunk.message_end_time) == (
                index.message_start_time,
                index.message_end_time,
            )
            for channel, offset in index.message_index_offsets.items():
                (entries,) = _records(data, offset, 1)
                assert isinstance(entries, MessageIndex)
                assert entries.channel_id == channel
                indexed |= {(channel, time) for time, _ in entries.records}
        assert indexed == {(each.channel_id, each.log_time) for each in listed}


@pytest.mark.parametrize("messages", [0, 3])
def test_what_the_summary_names_is_in_the_data_before_it(tmp_path, messages):
    """So that the tools that check MCAP files find nothing: also topics on which nothing came any more."""
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/said", *TOPICS["/said"], HASHES["/said"])
    for number in range(messages):
        writer.write("/said", 10**18 + number, message("/said", number))
    writer.flush()
    writer.add_topic("/tf", *TOPICS["/tf"], HASHES["/tf"])
    writer.close()
    found, ended = {Schema: ([], []), Channel: ([], [])}, False
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:  # those of chunks, too
            ended = ended or isinstance(record, DataEnd)
            if type(record) in found:
                found[type(record)][ended].append(record)
    for in_data, in_summary in found.values():
        assert in_data == in_summary
        assert len(in_data) == 2
    with BagReader(tmp_path / "bag") as bag:
        assert bag.counts == {"/said": messages, "/tf": 0}


def _records(data, offset, count):
    stream = StreamReader(ReadDataStream(io.BytesIO(data[offset:])), skip_magic=True, emit_chunks=True)
    records = stream.records
    return [next(records) for _ in range(count)]


def test_the_reader_of_mcap_decodes_messages(bag):
    """It knows no ros2idl."""
    decoded = []
    for part in parts(bag):
        with part.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            decoded += [(channel.topic, content) for _, channel, _, content in reader.iter_decoded_messages(PLAIN)]
    assert [content.data for topic, content in decoded if topic == "/said"] == [f"n{k}" for k in range(0, 24, 3)]
    assert [content.transforms for topic, content in decoded if topic == "/tf"] == [[]] * 8


def test_rosbags_decodes_all_and_finds_the_hashes_right(bag):
    """AnyReader compares the hashes of the definitions with those that are told."""
    with Reader(bag) as reader:
        read = [(c.topic, t, bytes(data)) for c, t, data in reader.messages()]
    with BagReader(bag) as ours:
        assert read == [(topic, time, bytes(data)) for topic, time, data in ours.messages(list(TOPICS))]
    with AnyReader([bag]) as reader:
        decoded = [(c.topic, reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages()]
    assert [content.data for topic, content in decoded if topic == "/said"] == [f"n{k}" for k in range(0, 24, 3)]
    events = [content for topic, content in decoded if topic.endswith("_event")]
    assert [(len(event.request), len(event.response)) for event in events] == [(0, 0)] * 8
    wanted = {topic: {kind} for topic, (kind, _) in TOPICS.items()}
    assert [each.topic for each in messages_of(bag, wanted)] == [topic for topic, _, _ in read]


def test_events_of_every_service_and_action_are_defined_as_ros_defines_them():
    """Their definitions have the hashes that ROS gives them: names, order and types of all fields that they contain."""
    assert len(EVENT_HASHES) > 40
    types_in = functools.cache(get_types_from_idl)  # most contain the same few types
    for name, told in EVENT_HASHES.items():
        encoding, text = full_definition(name)
        store, types = get_typestore(Stores.EMPTY), {}
        for part in re.split(r"^={80}\nIDL: .*\n", text, flags=re.MULTILINE)[1:]:
            types |= types_in(part)
        store.register(types)
        assert (encoding, store.hash_rihs01(name)) == ("ros2idl", told), name
