"""What was published comes back from a bag, byte for byte, with type, hash and delivery."""

import os
import signal
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from im_bringup.bag import BagReader
from im_core.ros import qos
from im_core.ros.interfaces import interface_class
from im_msgs.msg import Firing

RUN = Path(__file__).resolve().parent.parent / "scripts" / "run.sh"


@pytest.fixture
def recorder(process, tmp_path, wait_until):
    """``recorder(args...)``: a recording; its bag is ``tmp_path / "bag"``."""

    def start(*arguments):
        child = process("bash", RUN, "im_bringup", "record", "-o", tmp_path / "bag", *arguments)
        wait_until(lambda: "Ctrl-C ends it" in child.out.read_text(), "the recorder")
        return child

    return start


def end(child, number, wait_until):
    os.kill(child.pid, number)
    wait_until(lambda: child.poll() is not None, "the end of the recording")
    assert child.returncode == 0, child.out.read_text()


def firing(number):
    message = Firing(net="n", transition=f"t{number}", sequence=number, duration=0.25)
    message.stamp.sec = number
    return message


@pytest.fixture
def recorded(recorder, ros, wait_until, tmp_path):
    """A bag with a latched topic, events of a type of ours, an image, and a topic that appeared late."""
    node = Node("source")
    described = node.create_publisher(String, "/described", qos.LATCHED)
    described.publish(String(data="before anyone listened"))
    ros(node)
    child = recorder()
    events = node.create_publisher(Firing, "/events", qos.EVENTS)
    images = node.create_publisher(Image, "/image", qos.SENSOR)
    for publisher in (described, events, images):
        wait_until(publisher.get_subscription_count, f"the recorder on {publisher.topic_name}")
    for number in range(200):
        events.publish(firing(number))
    images.publish(Image(height=480, width=640, encoding="mono8", step=640, data=bytes(640 * 480)))
    late = node.create_publisher(TFMessage, "/tf", 10)
    wait_until(late.get_subscription_count, "the recorder on a late topic")
    late.publish(TFMessage())
    hashes = {
        topic: str(node.get_publishers_info_by_topic(topic)[0].topic_type_hash)
        for topic in ("/described", "/events", "/image", "/tf")
    }
    wait_until(lambda: late.wait_for_all_acked(), "the last message to arrive")
    end(child, signal.SIGINT, wait_until)
    return tmp_path / "bag", hashes


def test_a_bag_holds_what_was_published(recorded):
    path, hashes = recorded
    with BagReader(path) as bag:
        assert [bag.counts[topic] for topic in ("/described", "/events", "/image", "/tf")] == [1, 200, 1, 1]
        assert bag.types["/events"] == "im_msgs/msg/Firing"
        assert bag.deliveries["/described"].latched
        assert not bag.deliveries["/image"].reliable
        events = [deserialize_message(data, Firing) for _, _, data in bag.messages(["/events"])]
    assert events == [firing(number) for number in range(200)]
    text = (path / "metadata.yaml").read_text()
    for topic, type_hash in hashes.items():
        assert type_hash in text, f"{topic}: {type_hash}"

    # A reader that knows nothing of this workspace decodes our types from the bag alone.
    with (path / "bag.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [message for *_, message in reader.iter_decoded_messages(topics=["/events"])]
    assert [(message.transition, message.stamp.sec, message.duration) for message in decoded[:2]] == [
        ("t0", 0, 0.25),
        ("t1", 1, 0.25),
    ]


def test_replay_publishes_the_same_on_the_same_topics(recorded, ros, script, wait_until):
    path, _ = recorded
    node = Node("listener")
    texts, events = [], []
    node.create_subscription(String, "/described", texts.append, qos.LATCHED)
    node.create_subscription(Firing, "/events", lambda data: events.append(data), qos.EVENTS, raw=True)
    ros(node)
    done = script("replay", path, "--rate", 5, "--topics", "/events", "/described")
    assert done.returncode == 0, done.stderr
    assert "replay: 201 messages published" in done.stdout
    wait_until(lambda: len(events) == 200 and len(texts) >= 1, "the replayed messages")
    with BagReader(path) as bag:
        assert [bytes(data) for data in events] == [data for _, _, data in bag.messages(["/events"])]


def test_sigterm_closes_the_bag_too(recorder, ros, wait_until, tmp_path):
    node = ros(Node("source"))
    publisher = node.create_publisher(String, "/a", 10)
    node.create_publisher(String, "/b", 10)
    child = recorder("--topics", "/a")
    wait_until(publisher.get_subscription_count, "the recorder")
    publisher.publish(String(data="x"))
    wait_until(lambda: publisher.wait_for_all_acked(), "the message to arrive")
    end(child, signal.SIGTERM, wait_until)
    with BagReader(tmp_path / "bag") as bag:
        assert dict(bag.counts) == {"/a": 1}


def test_a_bag_is_never_overwritten(script, tmp_path):
    done = script("record", "-o", tmp_path)
    assert (done.returncode, f"the bag {tmp_path} cannot be made" in done.stderr) == (2, True)


@pytest.mark.parametrize("arguments", [["nowhere"], ["nowhere", "--rate", "0"], []])
def test_replay_refuses_what_it_cannot_play(script, arguments):
    assert script("replay", *arguments).returncode == 2


def test_message_classes_are_found_by_name():
    assert interface_class("std_msgs/msg/String") is String
