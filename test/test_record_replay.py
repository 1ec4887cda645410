"""What was published comes back from a bag, byte for byte, with type, hash and delivery."""

import contextlib
import os
import random
import shutil
import signal
import sys
from pathlib import Path

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rclpy.action import CancelResponse
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String, UInt8
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from im_bag import BagReader, BagWriter, Delivery
from im_bag.reading import messages_of, topics_of
from im_bag.ros import recorder as recorder_module
from im_bag.ros import replay
from im_bag.ros.recorder import BagRecorder, RecordedTopic
from im_core import clock
from im_core.errors import DataError, NotFoundError
from im_core.processes.startup import PHASE_TOPIC
from im_core.ros import qos
from im_core.ros.calls import pause
from im_core.ros.guard import GuardedActionClient, GuardedActionServer, GuardedNode
from im_core.ros.messages.interfaces import interface_class, message_class
from im_core.ros.node import ManagedNode
from im_msgs.action import ExecuteCommand
from im_msgs.msg import Firing

RUN = Path(__file__).resolve().parent.parent / "scripts" / "run.sh"


@pytest.fixture
def recorder(process, tmp_path, wait_until):
    """``recorder(args...)``: a recording; its bag is ``tmp_path / "bag"``."""

    def start(*arguments):
        child = process("bash", RUN, "im_bag", "record", "-o", tmp_path / "bag", *arguments)
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
    again = node.create_publisher(CompressedImage, "/image_raw/compressed", qos.IMAGES)
    for publisher in (described, events, images):
        wait_until(publisher.get_subscription_count, f"the recorder on {publisher.topic_name}")
    for number in range(200):
        events.publish(firing(number))
    images.publish(Image(height=480, width=640, encoding="mono8", step=640, data=bytes(640 * 480)))
    late = node.create_publisher(TFMessage, "/tf", 10)
    wait_until(late.get_subscription_count, "the recorder on a late topic")
    late.publish(TFMessage())
    assert not again.get_subscription_count(), "images would be compressed for nobody, and be there twice"
    hashes = {
        topic: str(node.get_publishers_info_by_topic(topic)[0].topic_type_hash)
        for topic in ("/described", "/events", "/image", "/tf")
    }
    for publisher in (described, events, late):
        wait_until(publisher.wait_for_all_acked, f"the messages of {publisher.topic_name} to arrive")
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
        numbers = [message.sequence for *_, message in reader.iter_messages(topics=["/events"])]
    assert numbers == list(range(1, 201)), "none was lost, by the numbers of the publisher"
    assert [(message.transition, message.stamp.sec, message.duration) for message in decoded[:2]] == [
        ("t0", 0, 0.25),
        ("t1", 1, 0.25),
    ]


def test_replay_publishes_the_same_on_the_same_topics(recorded, ros, script, wait_until):
    path, _ = recorded
    node = Node("listener")
    texts, events, times = [], [], []
    node.create_subscription(String, "/described", texts.append, qos.LATCHED)
    node.create_subscription(Firing, "/again", lambda data: events.append(data), qos.EVENTS, raw=True)
    node.create_subscription(Clock, "/clock", times.append, 100)
    ros(node)
    options = ("--rate", 5, "--remap", "/events:=/again", "--clock")
    done = script("replay", path, *options, "--topics", "/events", "/described")
    assert done.returncode == 0, done.stderr
    assert "replay: 201 messages published" in done.stdout
    wait_until(lambda: len(events) == 200 and len(texts) >= 1, "the replayed messages")
    wait_until(lambda: len(times) >= 1, "the time of the bag")
    stamps = [(told.clock.sec, told.clock.nanosec) for told in times]
    assert stamps == sorted(stamps)
    with BagReader(path) as bag:
        assert times[-1].clock.sec >= bag.begin_ns // 10**9
        assert [bytes(data) for data in events] == [data for _, _, data in bag.messages(["/events"])]


def test_a_bag_is_not_mixed_with_a_machine_unless_told_to(ros, script, tmp_path):
    """No record of this host tells of the machine: it may run on another one."""
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic("/tf", "tf2_msgs/msg/TFMessage", Delivery(True, False, 10), "")
    bag.write("/tf", 1, serialize_message(TFMessage()), 1, 1)
    bag.close()
    machine, got = Node("bootstrap"), []
    machine.create_publisher(UInt8, PHASE_TOPIC, qos.LATCHED)
    machine.create_subscription(TFMessage, "/tf", got.append, 10)
    ros(machine)
    done = script("replay", tmp_path / "bag")
    assert (done.returncode, got) == (2, [])
    assert done.stderr == (
        f"replay: a machine runs in ROS domain {os.environ['ROS_DOMAIN_ID']} (/bootstrap, with 0 other nodes); "
        "set another ROS_DOMAIN_ID, stop the machine, or mix the topics with --force\n"
    )
    done = script("replay", tmp_path / "bag", "--force")
    assert (done.returncode, "replay: 1 messages published" in done.stdout) == (0, True), done.stderr


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


def holds_messages(part):
    """Whether a message, and not only what topics there are, is in a file that is being written."""
    with part.open("rb") as file, contextlib.suppress(McapError):
        records = StreamReader(file, emit_chunks=True).records
        return any(isinstance(record, Chunk) and record.message_start_time > 0 for record in records)
    return False


@pytest.mark.parametrize("count", random.Random(15).sample(range(50, 600), 2))
def test_a_recorder_that_is_killed_leaves_a_bag_that_opens(recorder, ros, wait_until, tmp_path, count):
    node = ros(Node("source"))
    publisher = node.create_publisher(Firing, "/events", qos.EVENTS)
    child = recorder("--topics", "/events")
    wait_until(publisher.get_subscription_count, "the recorder")
    part = tmp_path / "bag" / "bag.mcap"
    publisher.publish(firing(0))
    wait_until(lambda: holds_messages(part), "the first flush")
    for number in range(1, count):
        publisher.publish(firing(number))
        if number % 50 == 0:
            clock.sleep(0.01)
    child.kill()
    wait_until(lambda: child.poll() is not None, "the end of the recorder")
    with BagReader(tmp_path / "bag") as bag:
        events = [deserialize_message(data, Firing) for _, _, data in bag.messages(["/events"])]
    assert events
    assert events == [firing(number) for number in range(len(events))]
    with part.open("rb") as file:
        decoded = [
            message for *_, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        ]
    assert len(decoded) == len(events)


def test_a_folder_that_is_removed_ends_the_recording_with_a_sentence(recorder, wait_until, tmp_path):
    child = recorder()
    shutil.rmtree(tmp_path / "bag")
    wait_until(lambda: child.poll() is not None, "the end of the recording")
    _, *told = child.out.read_text().splitlines()
    assert (child.returncode, len(told)) == (1, 1)
    assert told[0].startswith(f"record: {tmp_path / 'bag'} cannot be written: ")


@pytest.fixture
def refused(monkeypatch, capsys):
    """``refused(command, words...)``: what is said of a command line that is refused."""

    def run(command, *words):
        monkeypatch.setattr("sys.argv", ["command", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            sys.exit(command.main())
        assert ended.value.code == 2
        return capsys.readouterr().err

    return run


def test_a_bag_is_never_overwritten(refused, tmp_path):
    assert f"the bag {tmp_path} cannot be made" in refused(recorder_module, "-o", tmp_path)


@pytest.mark.parametrize(("first", "second"), [(qos.EVENTS, qos.SENSOR), (qos.LATCHED_EVENTS, qos.EVENTS)])
def test_a_publisher_that_offers_less_than_those_before_it_is_recorded_too(
    recorder, ros, wait_until, tmp_path, first, second
):
    node = ros(Node("source"))
    strong = node.create_publisher(String, "/a", first)
    child = recorder("--topics", "/a")
    wait_until(strong.get_subscription_count, "the recorder")
    expected = []

    def publish(publisher, text):
        publisher.publish(String(data=text))
        expected.append(text)

    for number in range(10):
        publish(strong, f"before {number}")
    weak = node.create_publisher(String, "/a", second)
    began, number = clock.monotonic(), 0
    while clock.monotonic() < began + 3.5:  # one subscription takes the place of the other meanwhile
        publish(strong, f"meanwhile {number}")
        number += 1
        clock.sleep(0.01)
    wait_until(weak.get_subscription_count, "the recorder on the second publisher")
    wait_until(lambda: strong.get_subscription_count() == 1, "the former subscription to end")
    for number in range(10):
        publish(weak, f"weak {number}")
        publish(strong, f"after {number}")
    clock.sleep(1.0)  # what is not reliable is not acknowledged
    end(child, signal.SIGINT, wait_until)
    with BagReader(tmp_path / "bag") as bag:
        texts = [deserialize_message(data, String).data for _, _, data in bag.messages(["/a"])]
    assert sorted(texts) == sorted(expected)
    for kind in ("before", "meanwhile", "weak", "after"):
        assert [text for text in texts if text.startswith(kind)] == [e for e in expected if e.startswith(kind)]


@pytest.fixture
def other_participant():
    """A node of another participant: one knows only one type of a topic."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = Node("other", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_the_type_of_a_topic_is_that_of_its_publishers_and_another_is_said_once(
    recorder, ros, other_participant, wait_until, tmp_path
):
    node = ros(Node("source"))
    other_participant.create_subscription(Clock, "/a", print, 10)  # before the publisher, in the order of names too
    child = recorder("--topics", "/a")
    publisher = node.create_publisher(String, "/a", 10)
    wait_until(publisher.get_subscription_count, "the recorder")
    for _ in range(2):
        other_participant.create_publisher(Clock, "/a", 10)
        clock.sleep(0.5)
    publisher.publish(String(data="x"))
    wait_until(publisher.wait_for_all_acked, "the message to arrive")
    end(child, signal.SIGINT, wait_until)
    told = "record: /a: only std_msgs/msg/String is recorded, not rosgraph_msgs/msg/Clock, also published there\n"
    assert child.out.read_text().count(told) == 1
    with BagReader(tmp_path / "bag") as bag:
        assert (dict(bag.types), dict(bag.counts)) == ({"/a": "std_msgs/msg/String"}, {"/a": 1})


def test_names_that_are_no_full_names_of_topics_are_refused(refused, tmp_path):
    told = refused(recorder_module, "-o", tmp_path / "bag", "--topics", "/tf", "joint_states")
    assert "error: --topics: joint_states is no full name of a topic: " in told
    assert not (tmp_path / "bag").exists()


def test_topics_that_never_appeared_are_named(recorder, ros, wait_until):
    publisher = ros(Node("source")).create_publisher(String, "/a", 10)
    child = recorder("--topics", "/a", "/never", "/nowhere")
    wait_until(publisher.get_subscription_count, "the recorder")
    end(child, signal.SIGINT, wait_until)
    assert "record: nobody published on /never, /nowhere\n" in child.out.read_text()


class Queue:
    """Stands for a subscription: messages that wait, with the time of their arrival [s]."""

    msg_type = String

    def __init__(self, *waiting):
        self.handle, self._waiting = self, list(waiting)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def take_message(self, _, raw):
        if not self._waiting:
            return None
        second, data = self._waiting.pop(0)
        told = {"received_timestamp": second * 10**9, "source_timestamp": 1, "publication_sequence_number": 1}
        return data, told


def test_a_clock_that_is_set_back_while_messages_wait_keeps_the_order_of_a_topic(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic("/a", "std_msgs/msg/String", Delivery(True, False, 10))
    recorder = BagRecorder(None, None, bag, [])
    recorder._topics["/a"] = RecordedTopic(None, "/a", "std_msgs/msg/String", Delivery(True, False, 10))
    recorder._topics["/a"]._ends.append(Queue((10, b"0"), (11, b"1"), (5, b"2"), (6, b"3")))
    recorder.drain()
    bag.close()
    with BagReader(tmp_path / "bag") as reader:
        assert [data for _, _, data in reader.messages(["/a"])] == [b"0", b"1", b"2", b"3"]


class Publisher:
    """Stands for one that goes on publishing while a recorder looks into its subscriptions, one after the other."""

    def __init__(self):
        self.sent, self.readers = 0, []

    def publish(self):
        self.sent += 1
        for reader in self.readers:
            reader.waiting.append(self.sent)

    def get_publishers_info_by_topic(self, _):
        return []

    def destroy_subscription(self, reader):
        self.readers.remove(reader)


class Reader:
    """Stands for a subscription to it that is connected just before it is looked at for the first time."""

    msg_type = String

    def __init__(self, publisher):
        self.handle, self.waiting, self._publisher = self, [], publisher

    def __enter__(self):
        self._publisher.publish()
        if self not in self._publisher.readers:
            self._publisher.readers.append(self)
        self._publisher.publish()
        return self

    def __exit__(self, *_):
        self._publisher.publish()

    def get_publisher_count(self):
        return 0

    def take_message(self, _, raw):
        if not self.waiting:
            return None
        number = self.waiting.pop(0)
        told = {"received_timestamp": number, "source_timestamp": number, "publication_sequence_number": number}
        return b"%d" % number, told


def test_what_comes_while_one_subscription_is_looked_at_after_the_other_keeps_its_order():
    publisher = Publisher()
    recorded = RecordedTopic(publisher, "/a", "std_msgs/msg/String", Delivery(True, False, 10))
    recorded._ends.append(Reader(publisher))
    publisher.readers.append(recorded._ends[0])
    got = []
    for _ in range(3):
        recorded._ends.append(Reader(publisher))
        recorded._until = clock.monotonic() + 0.2
        while len(recorded._ends) > 1:
            got += [int(data) for _, data, _ in recorded.take()]
        got += [int(data) for _, data, _ in recorded.take()]
    assert got == list(range(1, len(got) + 1))
    assert publisher.sent - len(got) < 5


def test_extracting_goes_with_nothing_that_is_of_publishing(refused, tmp_path):
    told = refused(replay, "nowhere", "--extract", tmp_path / "new", "--start", "3", "--loop")
    assert "error: --extract publishes nothing: it does not go with --start, --loop" in told


@pytest.mark.parametrize("arguments", [["nowhere"], ["nowhere", "--rate", "0"], ["nowhere", "--remap", "a=b"], []])
def test_replay_refuses_what_it_cannot_play(refused, arguments):
    assert refused(replay, *arguments)


def test_message_classes_are_found_by_name():
    assert interface_class("std_msgs/msg/String") is message_class("std_msgs/msg/String") is String
    assert message_class("std_srvs/srv/SetBool_Event") is SetBool.Event
    for name in ("std_srvs/srv/SetBool", "im_msgs/action/ExecuteCommand"):
        with pytest.raises(DataError, match=f"{name} is no type of messages, but that of a service or an action"):
            message_class(name)
    for name in ("std_msgs/String", "std_msgs/msg/String/", ""):
        with pytest.raises(NotFoundError, match=f"there is no type of the form package/msg/Type '{name}'"):
            interface_class(name)


class Teller(ManagedNode):
    """Answers a service and carries out an action."""

    def __init__(self):
        super().__init__("teller", parameter_overrides=[Parameter("introspection", value="contents")])
        self.create_service(SetBool, "/teller/set", self._set)
        self._server = GuardedActionServer(
            self, ExecuteCommand, "/teller/execute", self._execute, cancel_callback=lambda _: CancelResponse.ACCEPT
        )

    async def _set(self, request, response):
        response.success, response.message = request.data, "as asked"
        return response

    async def _execute(self, handle):
        while handle.request.symbol == "wait" and not handle.is_cancel_requested:
            await pause(self, 0.01)
        (handle.canceled if handle.is_cancel_requested else handle.succeed)()
        return ExecuteCommand.Result(success=True, results=handle.request.arguments)


def test_what_services_and_actions_carry_is_in_the_bag(recorder, ros, wait_until, tmp_path):
    node, other = Teller(), GuardedNode("asker")
    ros(node, other)
    child = recorder()
    action = "/teller/execute/_action"
    events = ("/teller/set", f"{action}/send_goal", f"{action}/get_result", f"{action}/cancel_goal")
    topics = {f"{name}/_service_event" for name in events}
    for topic in topics:
        wait_until(lambda topic=topic: node.count_subscribers(topic), f"the recorder on {topic}")
    clock.sleep(1.0)  # a writer knows its reader earlier than that knows it; what comes between is lost
    client = other.create_client(SetBool, "/teller/set")
    wait_until(client.service_is_ready, "the service")
    asked = client.call_async(SetBool.Request(data=True))
    wait_until(asked.done, "the answer")
    actions = GuardedActionClient(other, ExecuteCommand, "/teller/execute")
    wait_until(actions.server_is_ready, "the action")
    goal = actions.send_goal_async(ExecuteCommand.Goal(symbol="look", arguments='{"light": "left"}'))
    wait_until(goal.done, "the goal")
    result = goal.result().get_result_async()
    wait_until(result.done, "the result")
    waiting = actions.send_goal_async(ExecuteCommand.Goal(symbol="wait"))
    wait_until(waiting.done, "the second goal")
    cancelled, result = waiting.result().cancel_goal_async(), waiting.result().get_result_async()
    wait_until(lambda: cancelled.done() and result.done(), "its end")
    wait_until(lambda: all(each.wait_for_all_acked() for each in node.publishers), "the last event to arrive")
    end(child, signal.SIGINT, wait_until)
    types = {topic: kind for topic, kind in topics_of(tmp_path / "bag").items() if topic in topics}
    found = list(messages_of(tmp_path / "bag", {topic: (kind,) for topic, kind in types.items()}))
    told = ([each.content for each in found if each.topic.startswith(name)] for name in events)
    calls, goals, results, cancels = told
    assert [each.request[0].data for each in calls if each.request] == [True]
    assert [each.response[0].message for each in calls if each.response] == ["as asked"]
    assert [each.request[0].goal.arguments for each in goals] == ['{"light": "left"}', ""]
    assert [each.response[0].result.results for each in results] == ['{"light": "left"}', ""]
    ids = [bytes(each.request[0].goal_info.goal_id.uuid) for each in cancels]
    assert ids == [bytes(goals[1].request[0].goal_id.uuid)] == [bytes(results[1].request[0].goal_id.uuid)]
    assert results[1].response[0].status == GoalStatus.STATUS_CANCELED


def test_a_recording_that_has_begun_has_all_that_known_publishers_send_from_then_on(recorder, ros, wait_until):
    """Many topics, each with one message right after the recorder has said that it records."""
    node = Node("source")
    publishers = [node.create_publisher(String, f"/many/topic_{number}", 10) for number in range(40)]
    ros(node)
    child = recorder()
    for publisher in publishers:
        publisher.publish(String(data="once"))
    for publisher in publishers:
        wait_until(publisher.wait_for_all_acked, f"the message of {publisher.topic_name} to arrive")
    end(child, signal.SIGINT, wait_until)
    assert f"record: {len(publishers)} messages of" in child.out.read_text()
