"""``pnt bag``: what fired, after what, for how long, what is missing, out of a bag alone."""

import json
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from im_core.errors import DataError
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, OK
from im_pnt_analysis.recorded.firings import contents_of, mission_of

MESSAGES = Path(__file__).resolve().parents[2] / "im_msgs" / "msg"
START, END, FAILED = range(3)
JOB = """
net: job_net
places: {idle: 1, begin: , end: , bad: }
transitions:
  read: {symbol: job, in: idle, out: begin}
  work: {in: begin, out: end, action: work, delay: 2.5, on_failure: [bad]}
  tell: {in: end, out: idle, emit: job_done}
  regret: {in: bad, out: idle, emit: job_failed}
"""
#: Time [s], transition and phase; the numbers of the events are 1, 2, ..., without 8.
EVENTS = [
    (10.0, "read", START),
    (10.0, "read", END),
    (10.5, "work", START),
    (12.5, "work", END),
    (12.5, "tell", START),
    (12.5, "tell", END),
    (20.0, "read", START),
    None,
    (20.0, "read", END),
    (20.0, "work", START),
    (24.0, "work", FAILED),
    (24.0, "regret", START),
]


def types():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in ("Firing", "NetDescription"):
        store.register(get_types_from_msg((MESSAGES / f"{name}.msg").read_text(), f"im_msgs/msg/{name}"))
    return store


@pytest.fixture
def bag(tmp_path):
    return recorded(tmp_path / "bag", EVENTS)


def recorded(folder, events, silent=()):
    """A bag with events of the net, and topics without messages."""
    store = types()
    firing, described = (store.types[f"im_msgs/msg/{name}"] for name in ("Firing", "NetDescription"))
    time = store.types["builtin_interfaces/msg/Time"]
    told = json.dumps(
        {"net": "job_net", "description": "", "symbols": ["job"], "services": [], "yaml": JOB, "journal": False}
    )
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in silent:
            writer.add_connection(topic, firing.__msgtype__, typestore=store)

        def send(topic, seconds, message):
            connection = next((each for each in writer.connections if each.topic == topic), None)
            connection = connection or writer.add_connection(topic, message.__msgtype__, typestore=store)
            data = store.serialize_cdr(message, message.__msgtype__)
            writer.write(connection, round((1000.0 + seconds) * 1e9), data)

        send("/pnt/nets", 9.0, described(net="job_net", node="/n", json=told))
        for number, event in enumerate(events, 1):
            if event is None:
                continue
            seconds, transition, phase = event
            given = dict.fromkeys(("symbol", "message"), "") | dict.fromkeys(("duration", "progress"), 0.0)
            stamp = time(sec=int(seconds), nanosec=round(seconds % 1.0 * 1e9))
            names = {"net": "job_net", "transition": transition, "sequence": number, "phase": phase, "command_id": 3}
            send("/pnt/firings", seconds, firing(stamp=stamp, **names, **given))
        send("/pnt/nets", 20.0, described(net="job_net", node="/n", json=""))  # it was unloaded
    return folder


def test_starts_and_ends_are_joined_and_say_after_what(bag):
    told = [(each.transition, each.begin_s, each.end_s, each.failed, each.after) for each in mission_of(bag).firings]
    assert told == [
        ("read", 0.0, 0.0, False, ""),
        ("work", 0.5, 2.5, False, "read"),
        ("tell", 2.5, 2.5, False, "work"),
        ("read", 10.0, 10.0, False, "tell"),
        ("work", 10.0, 14.0, True, "read"),
        ("regret", 14.0, None, False, "work"),
    ]


def test_actions_stand_beside_what_their_net_expects(bag):
    (work,) = mission_of(bag).actions()
    assert (work.transition, work.count, work.failures) == ("work", 2, 1)
    assert (work.mean_s, work.median_s, work.longest_s, work.expected_s) == (3.0, 3.0, 4.0, 2.5)


def test_events_that_were_not_recorded_are_gaps(bag):
    assert mission_of(bag).gaps == [("job_net", 8, 8)]


def test_contents_tell_the_longest_silence(bag):
    nets, firings = sorted(contents_of(bag), key=lambda topic: topic.count)
    assert (nets.name, nets.count, nets.silence_s) == ("/pnt/nets", 2, 11.0)
    assert (firings.name, firings.count) == ("/pnt/firings", 11)
    assert firings.silence_s == pytest.approx(7.5)


def test_the_command_prints_and_draws(bag, capsys, tmp_path):
    assert main(["bag", str(bag), "--picture", str(tmp_path / "mission.svg")]) == OK
    printed = capsys.readouterr().out
    assert "10.000       4.000  FAILED  #3 job_net.work  after read" in printed
    assert "net job_net: events 8 to 8 were not recorded" in printed
    assert "<svg" in (tmp_path / "mission.svg").read_text()


def test_of_a_long_bag_the_ends_are_printed_and_what_is_left_out_is_counted(tmp_path, capsys):
    events = [(float(number), "read", phase) for number in range(100) for phase in (START, END)]
    long = str(recorded(tmp_path / "bag", events, [f"/silent_{number}" for number in range(110)]))
    assert main(["bag", long]) == OK
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) < 90
    assert printed[:2] == ["CONTENTS", "110 topics without messages (--all)"]
    assert {"... 40 firings more (--all)"} < set(printed)
    begun = [line.split()[0] for line in printed if "job_net.read" in line]
    assert begun == [f"{number}.000" for number in (*range(30), *range(70, 100))]
    assert main(["bag", long, "--all"]) == OK
    printed = capsys.readouterr().out
    assert (printed.count("/silent_"), printed.count("job_net.read"), "--all" in printed) == (110, 100, False)


def test_a_bag_without_firings_is_refused_in_a_sentence(tmp_path, capsys):
    store = types()
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/pnt/firings", "im_msgs/msg/Firing", typestore=store)
    with pytest.raises(DataError, match="nothing has fired in it"):
        mission_of(tmp_path / "bag")
    assert main(["bag", str(tmp_path / "nowhere")]) == BAD_INPUT
    assert "nowhere" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("definition", "sentence"),
    [
        (
            "builtin_interfaces/Time stamp\nstring net\nstring transition\n",
            "im_msgs/msg/Firing is defined there without 'command_id': it was recorded with another version",
        ),
        ("", "there is no definition of im_msgs/msg/Firing in it, by which /pnt/firings could be read"),
    ],
)
def test_a_type_that_has_changed_or_is_not_defined_is_said_to_be(tmp_path, definition, sentence):
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(definition, "im_msgs/msg/Firing"))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/pnt/firings", "im_msgs/msg/Firing", msgdef=definition, rihs01="-")
    with pytest.raises(DataError, match=sentence):
        mission_of(tmp_path / "bag")


def test_a_folder_without_a_bag_is_said_to_be_one(bag, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="empty: there is no bag in it"):
        mission_of(tmp_path / "empty")
    with pytest.raises(DataError, match="is a folder of bags; name one: bag"):
        mission_of(tmp_path)
