"""Pace, pause, step, seek and loop of a replay, with a clock that the test moves."""

import threading

import pytest

from im_bag import BagReader, BagWriter, Delivery
from im_bag.playback import Controls, Playback
from im_core import clock
from im_core.errors import DataError

STRING = "std_msgs/msg/String"


class Time:
    """A clock, and an event whose waiting moves it; what is to happen meanwhile is played from a list."""

    def __init__(self, controls):
        self.now, self.controls, self.script = 100.0, controls, []
        controls.changed = self

    def clear(self):
        pass

    def set(self):
        pass

    def wait(self, seconds=None):
        if self.script and (seconds is None or self.now + seconds >= self.script[0][0]):
            moment, key = self.script.pop(0)
            self.now = max(self.now, moment)
            self.controls.press(key)
        else:
            assert seconds is not None, "paused for ever"
            assert seconds <= threading.TIMEOUT_MAX
            self.now += seconds


@pytest.fixture
def time(monkeypatch):
    made = Time(Controls())
    monkeypatch.setattr(clock, "monotonic", lambda: made.now)
    return made


@pytest.fixture
def bag(tmp_path):
    """Twenty messages, one a second, and a latched topic that tells the second 0, 4, 8, ..."""
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/a", STRING, Delivery(True, False, 5))
    writer.add_topic("/latched", STRING, Delivery(True, True, 1))
    for number in range(20):
        stamp_ns = (1000 + number) * 10**9
        if number % 4 == 0:
            writer.write("/latched", stamp_ns, bytes([number]))
        writer.write("/a", stamp_ns + 1, bytes([number]))
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        yield reader


def played(bag, time, topics=("/a",), most=1000, **options):
    """Number and moment of the messages."""
    found = []
    for topic, _, data in Playback(bag, list(topics), time.controls, **options).messages():
        found.append((data[0] if topic == "/a" else f"latched {data[0]}", round(time.now - 100.0, 3)))
        if len(found) == most:
            break
    return found


def test_messages_come_at_their_pace(bag, time):
    assert played(bag, time, rate=4.0) == [(number, number / 4) for number in range(20)]


def test_a_start_in_the_middle_begins_with_what_is_latched_there(bag, time):
    found = played(bag, time, ("/a", "/latched"), start_s=5.5)
    assert found[:4] == [("latched 0", 0.0), ("latched 4", 0.0), (6, 0.5), (7, 1.5)]


def test_the_time_begins_at_the_place_and_never_goes_back(bag, time):
    time.script = [(102.5, "right")]
    told = []
    playback = Playback(bag, ["/a", "/latched"], time.controls, start_s=5.5, begins=told.append)
    stamps = [stamp_ns * 1e-9 - 1000.0 for _, stamp_ns, _ in playback.messages()]
    assert [place_ns * 1e-9 - 1000.0 for place_ns in told] == pytest.approx([5.5, 13.0])
    assert stamps[:7] == pytest.approx([5.5, 5.5, 6.0, 7.0, 13.0, 13.0, 13.0])
    assert stamps == sorted(stamps)


def test_what_is_latched_comes_in_the_order_of_time(tmp_path, time):
    writer = BagWriter(tmp_path / "bag")
    for topic in ("/a", "/b"):
        writer.add_topic(topic, STRING, Delivery(True, True, 1))
    for number, topic in enumerate(("/b", "/a", "/b", "/a", "/a")):
        writer.write(topic, (1000 + number) * 10**9, bytes([number]))
    writer.close()
    with BagReader(tmp_path / "bag") as reader:
        messages = Playback(reader, ["/a", "/b"], time.controls, start_s=3.5).messages()
        assert [data[0] for _, _, data in messages] == [0, 1, 2, 3, 4]


def test_a_pause_moves_what_follows_and_a_step_lets_one_through(bag, time):
    time.script = [(102.5, " "), (110.0, "."), (111.0, "."), (120.0, " ")]
    assert played(bag, time)[:7] == [(0, 0.0), (1, 1.0), (2, 2.0), (3, 10.0), (4, 11.0), (5, 21.0), (6, 22.0)]


def test_keys_seek_both_ways(bag, time):
    time.script = [(102.5, "right"), (103.7, "left")]
    found = [number for number, _ in played(bag, time)]
    assert found == [0, 1, 2, 8, *range(4, 20)]


@pytest.fixture
def silent_bag(tmp_path):
    """Messages at 0, 1, 2, 60 and 61 s."""
    writer = BagWriter(tmp_path / "silent")
    writer.add_topic("/a", STRING, Delivery(True, False, 5))
    for number, second in enumerate((0, 1, 2, 60, 61)):
        writer.write("/a", (1000 + second) * 10**9, bytes([number]))
    writer.close()
    with BagReader(tmp_path / "silent") as reader:
        yield reader


def test_keys_seek_from_where_the_replay_stands(silent_bag, time):
    time.script = [(103.0, "left")]
    assert played(silent_bag, time, most=5) == [(0, 0.0), (1, 1.0), (2, 2.0), (0, 3.0), (1, 4.0)]


def test_a_pause_does_not_move_the_place_to_seek_from(silent_bag, time):
    time.script = [(104.0, " "), (130.0, "right"), (140.0, " ")]  # from 4 s: 51 s are left from 9 s to the next
    assert played(silent_bag, time)[3:] == [(3, 91.0), (4, 92.0)]


def test_a_message_that_is_due_in_centuries_is_waited_for(tmp_path, time):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/a", STRING, Delivery(True, False, 5))
    for number, stamp_ns in enumerate((0, 1_700_000_000 * 10**9)):
        writer.write("/a", stamp_ns, bytes([number]))
    writer.close()
    time.script = [(8000.0, "q")]
    with BagReader(tmp_path / "bag") as reader:
        assert played(reader, time, rate=0.1) == [(0, 0.0)]


def test_a_loop_begins_again_and_ends_when_asked(bag, time):
    assert [number for number, _ in played(bag, time, loop=True, most=45)] == [*range(20), *range(20), *range(5)]
    time.controls.end()
    assert played(bag, time, loop=True) == []


@pytest.fixture
def early_bag(tmp_path):
    """One message at 0 s, another one of another topic at 10 s."""
    writer = BagWriter(tmp_path / "early")
    for topic, second in (("/a", 0), ("/latched", 10)):
        writer.add_topic(topic, STRING, Delivery(True, False, 5))
        writer.write(topic, (1000 + second) * 10**9, bytes([second]))
    writer.close()
    with BagReader(tmp_path / "early") as reader:
        yield reader


def test_a_round_of_a_loop_lasts_as_long_as_the_bag(early_bag, time):
    assert played(early_bag, time, loop=True, rate=2.0, most=3) == [(0, 0.0), (0, 5.0), (0, 10.0)]


def test_a_loop_over_a_moment_is_no_flood(early_bag, time):
    assert played(early_bag, time, ("/latched",), loop=True, start_s=10.0, rate=2.0, most=3) == [
        ("latched 10", 0.0),
        ("latched 10", 0.1),
        ("latched 10", 0.2),
    ]


def test_pause_step_and_seek_reach_the_silence_at_the_end_of_a_loop(early_bag, time):
    time.script = [(102.0, " "), (104.0, "."), (105.0, "."), (106.0, " "), (108.0, "left")]
    found = played(early_bag, time, loop=True, most=5)
    assert found == [(0, 0.0), (0, 4.0), (0, 5.0), (0, 8.0), (0, 18.0)]


def test_a_start_beyond_the_end_is_refused(bag, time):
    with pytest.raises(DataError, match=r"start 30 s is not in the bag, 0 to 19.000 s"):
        played(bag, time, start_s=30.0)
