"""The owner's end of the channel: heartbeats, and a servo process that hangs."""

import os

import numpy as np
import pytest

from im_core import clock
from im_core.errors import LinkError
from im_mcs.client.servo_client import ServoClient
from im_mcs.client.time_source import FlowingTime
from im_mcs.protocol.channel import ServoChannel, channel_name
from im_mcs.protocol.points import TimedPoints, pack_points, unpack_points
from im_mcs.state import Event

INSTANCE = f"im_mcs_client_{os.getpid()}"
HANGS = LinkError("the servo process hangs")


@pytest.fixture
def ends(config):
    """The owner's client, and the servo's end of the channel."""
    channel = ServoChannel.create(channel_name(INSTANCE), ServoChannel.layout(config))
    servo = ServoChannel.attach(channel_name(INSTANCE), ServoChannel.layout(config), 60.0)
    client = ServoClient(channel, FlowingTime())
    yield client, servo
    client.close()
    servo.close()
    channel.close()


def heard(servo):
    return [(m["request"], m["arguments"]) for m in servo.requests.receive_all()]


def test_the_client_s_thread_gives_no_signs_of_life(ends):
    """Else a node that hangs would go unnoticed as long as this thread runs."""
    client, servo = ends
    clock.sleep(0.1)
    assert servo.heartbeat.silence_s() == 0.0  # there was none yet: nobody is missed
    client.beat()
    assert servo.heartbeat.silence_s() == 0.0
    clock.sleep(0.1)
    assert servo.heartbeat.silence_s() >= 0.1
    client.beat()
    assert servo.heartbeat.silence_s() == 0.0


def test_the_longest_trajectory_of_all_joints_reaches_the_servo(ends, config):
    client, servo = ends
    rows = np.random.default_rng(0).normal(size=(3, config.planning.max_trajectory_points, len(config.joint_slots)))
    packed = pack_points(TimedPoints(rows[0, :, 0], *rows))
    client.send(Event.MOVE, {"path": {"points": packed}})
    ((_, arguments),) = heard(servo)
    found = unpack_points(arguments["path"]["points"])
    for values, sent in zip((found.times, found.q, found.v, found.a), (rows[0, :, 0], *rows), strict=True):
        np.testing.assert_array_equal(values, sent)


def test_while_the_servo_hangs_nobody_waits_and_only_an_estop_is_passed_on(ends):
    client, servo = ends
    replies = []
    number = client.send(Event.MOVE, {"group": "left"}, replies.append)
    client.suspend(HANGS)
    assert [reply.error for reply in replies] == [HANGS]
    assert heard(servo) == [("move", {"group": "left"}), ("cancel", {"goal": number})]
    with pytest.raises(LinkError, match="the servo process hangs"):
        client.send(Event.POWER_ON)
    client.send(Event.ESTOP, {"reason": "hand"}, replies.append)
    client.suspend(HANGS)
    assert len(replies) == 2
    assert ("estop", {"reason": "hand"}) in heard(servo)
    client.suspend(HANGS)
    assert heard(servo) == []
    client.resume()
    client.send(Event.POWER_ON)
    assert heard(servo) == [("power_on", {})]


def test_what_the_servo_leaves_lying_is_counted_from_when_it_was_sent(ends):
    client, servo = ends
    assert client.unheard_s() == 0.0
    clock.sleep(0.3)
    client.send(Event.POWER_ON)
    assert client.unheard_s() < 0.3
    clock.sleep(0.2)
    client.send(Event.POWER_OFF)
    assert client.unheard_s() >= 0.2, "the second one lies behind the first"
    assert len(heard(servo)) == 2
    assert client.unheard_s() == 0.0


def test_a_full_queue_does_not_keep_the_answers_back(ends):
    client, servo = ends
    replies = []
    room = (servo.requests.capacity - 100) // 50_100
    for _ in range(room):
        client.send(Event.MOVE, {"path": "x" * 50_000}, replies.append)
    with pytest.raises(LinkError, match="is full"):
        client.send(Event.MOVE, {"path": "x" * 50_000})
    client.suspend(HANGS)
    assert len(replies) == room
    assert all(reply.error is HANGS for reply in replies)


def test_of_a_servo_that_stopped_in_the_middle_of_writing_the_state_before_is_known(ends):
    client, servo = ends
    record = servo.snapshot.record()
    record["tick"] = 7
    servo.snapshot.write(record)
    assert client.snapshot()["tick"] == 7
    servo.snapshot._sequence[()] += 1
    servo.snapshot._bytes[:] = 255
    assert client.snapshot()["tick"] == 7
    servo.snapshot.write(record)
    assert client.snapshot()["tick"] == 7
