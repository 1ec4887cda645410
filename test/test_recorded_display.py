"""The nets over a recorded mission on the page: the marking at any moment is the one that the nets had."""

import asyncio
import json
from collections.abc import Mapping
from pathlib import Path

import aiohttp
import pytest

from im_bag import BagReader, BagWriter
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT
from im_pnt_analysis.recorded.firings import mission_of
from im_pnt_analysis.recorded.timeline import Described, Moment, NetRecording, RecordedMarking, recording_of
from im_pnt_display import DisplayServer
from im_pnt_display.page.recorded_cell import RecordedCell
from im_pnt_display.page.recording import FIRINGS_AHEAD, RecordedNets
from im_pnt_display.page.site import RECORDED
from support.bag_with_cell import JOINT, write_bag_with_cell
from support.viewer import next_change

BAGS = Path(__file__).parent / "data" / "bags"
NAMES = sorted(path.name for path in BAGS.iterdir() if path.is_dir())


@pytest.mark.parametrize("name", NAMES)
def test_firings_lead_to_each_marking_that_was_recorded(name):
    recording = recording_of(BAGS / name)
    states, compared, all_markings = recording.states(0), 0, 0
    for moment in recording.moments:
        if isinstance(marking := moment.event, RecordedMarking):
            before = states[marking.net].marking
            all_markings += 1
            if before.sequence == marking.sequence:  # on a busy computer firings may come after their marking
                assert before.tokens == marking.tokens, f"{marking.net} at {moment.at_s:.3f} s"
                compared += 1
        recording.advance(states, moment)
    assert 3 * compared > all_markings > 50
    assert {state.description for state in states.values()} == set(range(len(recording.descriptions)))


@pytest.mark.parametrize("share", [0.35, 0.6, 0.85])
def test_a_bag_whose_end_is_missing_shows_what_it_holds(tmp_path, share):
    """As long as its recorder lived, it is the same: nets, markings and firings."""
    whole, copy = recording_of(BAGS / "faults"), BagWriter(tmp_path / "faults")
    with BagReader(BAGS / "faults") as bag:
        for topic, kind in bag.types.items():
            copy.add_topic(topic, kind, bag.deliveries[topic], bag.hashes[topic])
        for number, (topic, stamp_ns, data) in enumerate(bag.messages(bag.types)):
            copy.write(topic, stamp_ns, data)
            if number % 50 == 0:
                copy.flush()
    copy.close()
    (part,) = (tmp_path / "faults").glob("*.mcap")
    part.write_bytes(part.read_bytes()[: int(share * part.stat().st_size)])
    (tmp_path / "faults" / "metadata.yaml").unlink()
    cut = recording_of(tmp_path / "faults")
    assert 0 < len(cut.moments) < len(whole.moments)
    assert cut.moments == whole.moments[: len(cut.moments)]
    nets = [cut.descriptions[number].net for number in range(len(whole.descriptions))]
    assert nets == [each.net for each in whole.descriptions]


@pytest.fixture(scope="module")
def shown():
    recording = recording_of(BAGS / "faults")
    server = DisplayServer(port=0, recording=RecordedNets("faults", recording))
    server.start()
    yield recording, server
    server.stop()


def asked(server, path, **headers):
    async def ask():
        async with aiohttp.ClientSession() as session, session.get(server.url + path, headers=headers) as answer:
            return answer.status, await answer.text()

    return asyncio.run(ask())


def moment(server, **place):
    (((key, value),)) = place.items()
    status, text = asked(server, f"recording.json?{key}={value}")
    assert status == 200, text
    return json.loads(text)


def markings(changes) -> Mapping[str, object]:
    return {change["net"]: change for change in changes if change["kind"] == "marking"}


def test_a_viewer_learns_of_the_whole_recording(shown):
    recording, server = shown
    overview = json.loads(asked(server, "state.json")[1])["recording"]
    mission = mission_of(BAGS / "faults")
    assert (overview["name"], overview["firings"]) == ("faults", recording.firings)
    assert len(overview["drawings"]) == len(recording.descriptions) == 19
    assert overview["gaps"] == []
    bars = {(overview["rows"][row], begin, end, failed) for row, begin, end, failed, _ in overview["bars"]}
    assert bars == {
        (f"{firing.net}.{firing.transition}", firing.begin_s, firing.end_s, firing.failed)
        for firing in mission.firings
        if firing.on_time_line
    }
    failed = {label for label, *_, failed in bars if failed}
    assert {"calibrate_camera.move_robot", "calibrate_camera.find_spot"} <= failed, "which took no time, perhaps"


def test_what_follows_a_moment_leads_to_the_next_one(shown):
    recording, server = shown
    at, played = moment(server, firing=0), {}
    while True:
        played = markings(at["markings"])
        for step in at["steps"]:
            played |= markings(step["changes"])
        if not at["more"]:
            break
        there = at["steps"][-1]["firing"]
        assert there == at["firing"] + FIRINGS_AHEAD
        at = moment(server, firing=there)
        assert markings(at["markings"]) == played
    assert at["steps"][-1]["firing"] == recording.firings
    assert played == markings(moment(server, at=recording.moments[-1].at_s)["markings"])


def test_a_net_that_was_unloaded_leaves_the_page_at_its_moment():
    known = recording_of(BAGS / "faults")
    last = known.moments[-1].at_s
    unloaded = Moment(last, Described("calibrate_camera", None))
    shown = RecordedNets("one", NetRecording(known.descriptions, [*known.moments, unloaded], known.mission))
    before = shown.moment({"firing": str(known.firings)})
    assert before["steps"][-1]["changes"] == [{"kind": "gone", "net": "calibrate_camera"}]
    numbers = {description.net.name: number for number, description in enumerate(known.descriptions)}
    after = shown.moment({"at": str(last)})
    assert set(before["nets"]) - set(after["nets"]) == {numbers["calibrate_camera"]}


def test_a_moment_has_the_actions_that_run_and_the_firings_before_it(shown):
    recording, server = shown
    number = next(
        recording.firings_until(rank + 1)
        for rank, each in enumerate(recording.moments)
        if not isinstance(each.event, RecordedMarking | Described) and each.event.transition == "move_manip"
    )
    at = moment(server, firing=number)
    assert markings(at["markings"])["motion_coordinator"]["active"] == ["move_manip"]
    assert at["firings"][-1]["transition"] == "move_manip"
    assert len(at["firings"]) == min(number, 300)


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("", "give the moment as 'at', a time in seconds, or as 'firing', the number of a firing"),
        ("at=nan", "'nan' is no time in seconds"),
        ("at=soon", "'soon' is no time in seconds"),
        ("firing=-1", "'-1' is no number of a firing"),
        ("firing=1000000", "there is no firing 1000000"),
        ("firing=" + "9" * 5000, "is no number of a firing"),
    ],
)
def test_what_is_no_moment_is_said_to_be_none(shown, query, sentence):
    status, text = asked(shown[1], f"recording.json?{query}")
    assert status == 400
    assert sentence in text


def test_a_recording_is_guarded_as_running_nets_are(shown):
    port = shown[1].url.rpartition(":")[2].strip("/")
    for headers in ({"Host": "evil.example"}, {"Host": f"localhost:{port}", "Origin": "http://evil.example"}):
        assert asked(shown[1], "recording.json?at=0", **headers)[0] == 403


def test_nothing_is_operated_in_a_recording(shown):
    async def talk():
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{shown[1].url}ws") as viewer:
            snapshot = await next_change(viewer)
            await viewer.send_json({"net": "cell", "request": "pause", "argument": ""})
            return snapshot, await next_change(viewer)

    snapshot, answer = asyncio.run(talk())
    assert snapshot["operable"] is False
    assert (answer["success"], answer["message"]) == (False, RECORDED)


@pytest.fixture(scope="module")
def with_cell(tmp_path_factory):
    """A bag with a cell, its recording, its number of firings, and a page over it."""
    bag = tmp_path_factory.mktemp("bags") / "cell"
    firings = write_bag_with_cell(BAGS / "undisturbed", bag)
    recording = recording_of(bag)
    server = DisplayServer(port=0, recording=RecordedNets("cell", recording, RecordedCell(bag)))
    server.start()
    yield recording, firings, server
    server.stop()


def parts(server, query):
    status, text = asked(server, f"cell.json?{query}")
    assert status == 200, text
    return {change["part"]: change["content"] for change in json.loads(text)}


def test_the_cell_is_as_it_was_at_each_moment(with_cell):
    recording, firings, server = with_cell
    assert json.loads(asked(server, "state.json")[1])["recording"]["cell"] is True
    end = recording.moments[-1].at_s
    first, last = parts(server, "at=0"), parts(server, f"at={end}")
    assert first["robot"].startswith("<?xml")
    assert first["frame/wall"]["xyz"] == [0.0, 0.0, 2.0]
    assert first["marker/lights/0"]["frame"] == "left_led"
    assert "marker/odd/1" not in first, "no page could draw it"
    assert first["image/wall"] is first["spot/wall"] is None, "none has been taken"
    assert last["image/wall"].startswith("data:image/png;base64,")
    assert last["spot/wall"] == [1.0, 2.0]
    turned = [parts(server, f"at={end * share}")["joints"][JOINT] for share in (0.0, 0.3, 0.6, 1.0)]
    assert turned == sorted(turned)
    assert turned[0] < turned[1] < turned[3] <= firings / 1000.0


def test_of_the_cell_only_what_has_changed_is_told_again(with_cell):
    recording, _, server = with_cell
    end = recording.moments[-1].at_s
    assert parts(server, f"at={end}&since={end}") == {}
    assert parts(server, f"at={end}&since={0.9 * end}").keys() == {"joints"}
    assert parts(server, f"at=0&since={end}")["image/wall"] is None, "who goes back sees it go"


def test_a_bag_without_a_robot_has_no_cell(shown):
    assert not RecordedCell(BAGS / "faults").recorded
    assert parts(shown[1], "at=0") == {}
    assert asked(shown[1], "cell.json?at=soon")[0] == asked(shown[1], "cell.json")[0] == 400


def test_running_nets_have_no_recording():
    server = DisplayServer(port=0)
    server.start()
    try:
        for path in ("recording.json", "cell.json"):
            assert asked(server, f"{path}?at=0")[0] == 404
        assert json.loads(asked(server, "state.json")[1])["recording"] is None
    finally:
        server.stop()


def test_the_command_says_what_cannot_be_shown(tmp_path, capsys):
    assert main(["display", str(tmp_path / "nowhere")]) == BAD_INPUT
    assert "nowhere" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["display", str(BAGS / "faults"), "--port", "99999"])
    assert "99999 is no TCP port, 0 to 65535" in capsys.readouterr().err
