"""How commands have ended is known after the node that ran them has died; the last ones, and not for ever."""

import json
import subprocess
import sys
import tracemalloc
from itertools import pairwise

import pytest

from im_pnt_node.journal import ended as module
from im_pnt_node.journal.ended import EndedCommand, EndedCommands
from im_pnt_node.ros.commands.execute import ended_state


def one(number: int, symbol: str = "pick", time: float = 1000.0) -> EndedCommand:
    return EndedCommand(
        number=number, symbol=symbol, time=time, success=number % 2 == 0, code="limit", message="too far",
        facts={"joint": '"left_j3"'}, results={"number": number, "text": "ö"},
    )  # fmt: skip


@pytest.fixture
def now(monkeypatch):
    times = [1000.0]
    monkeypatch.setattr(module, "wall", lambda: times[0])
    return times


def test_what_ended_before_a_death_is_known_after_it(tmp_path, now):
    first = EndedCommands()
    file = tmp_path / "ended" / "n.jsonl"
    first.keep_in(file, sync=True)
    for number in (3, 1, 2):
        first.add(one(number))
    first.add(one(1, "place"))
    with file.open("ab") as cut:
        cut.write(one(9).model_dump_json().encode()[:-5])  # the node died while it wrote
    again = EndedCommands()
    again.keep_in(file, sync=False)
    assert [number in again for number in (1, 2, 3, 9)] == [True, True, True, False]
    assert again[3] == one(3)
    assert again.last("pick") == one(2)
    assert again.last("place") == one(1, "place")
    assert again.last("wave") is None
    assert again.largest() == 3


def test_only_the_last_ones_are_kept_and_not_for_ever(tmp_path, now):
    ended = EndedCommands()
    ended.keep_in(tmp_path / "commands.jsonl", sync=False)
    for number in range(1, 3 * module.MOST + 1):
        ended.add(one(number))
    again = EndedCommands()
    again.keep_in(tmp_path / "commands.jsonl", sync=False)
    for each in (ended, again):
        assert 2 * module.MOST not in each
        assert 2 * module.MOST + 1 in each
    now[0] += module.AGE_S + 1.0
    assert 3 * module.MOST not in again
    assert again.last("pick") is None


def test_the_file_stays_about_as_long_as_what_is_kept(tmp_path, now):
    ended, file = EndedCommands(), tmp_path / "commands.jsonl"
    ended.keep_in(file, sync=False)
    report, sizes = {"report": "x" * 10_000}, []
    for number in range(1, 4 * module.MOST + 1):
        ended.add(one(number).model_copy(update={"results": report}))
        sizes.append(file.stat().st_size)
    line = len(file.read_bytes().splitlines()[-1]) + 1
    assert max(sizes) <= 1.21 * module.MOST * line
    assert sum(later < sooner for sooner, later in pairwise(sizes)) < 20, "it is seldom written anew"


def test_what_is_kept_is_bounded_whatever_commands_return(tmp_path, now, monkeypatch):
    monkeypatch.setattr(module, "MOST_BYTES", 100_000)
    ended, file = EndedCommands(), tmp_path / "commands.jsonl"
    ended.keep_in(file, sync=False)
    for number, length in enumerate([30_000] * 10 + [500_000, 10], start=1):
        ended.add(one(number).model_copy(update={"results": {"report": "x" * length}}))
        assert file.stat().st_size <= 1.2 * max(100_000, length + 1000)
        assert number in ended
    assert [number in ended for number in (10, 11, 12)] == [False, False, True]


def test_what_a_command_returned_takes_no_more_than_its_text(now):
    """A calibration returns some thousand numbers."""
    ended, report = EndedCommands(), {"report": [[number / 7.0] * 3 for number in range(1000)]}
    commands = 10
    text = len(json.dumps(report))
    tracemalloc.start()
    try:
        for number in range(1, commands + 1):
            ended.add(EndedCommand(**{**dict(one(number)), "results": json.loads(json.dumps(report))}))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 1.1 * commands * text
    assert ended[commands].results == report


def test_halves_of_characters_and_no_numbers_are_kept(now):
    ended = EndedCommands()
    odd = EndedCommand.model_construct(**{**dict(one(1)), "message": "\ud800", "results": {"at": float("inf")}})
    ended.add(odd)
    assert ended[1] == odd
    ended.add(one(2).model_copy(update={"results": {"what": object()}}))  # a net without a journal may return it
    assert ended[2] == one(2).model_copy(update={"results": {}})


def test_a_damaged_file_or_a_full_disk_ends_nothing(tmp_path, now):
    (tmp_path / "commands.jsonl").write_bytes(b"\xff\x00{}\n[]\n")
    ended = EndedCommands()
    ended.keep_in(tmp_path / "commands.jsonl", sync=False)
    (tmp_path / "commands.jsonl").unlink()
    (tmp_path / "commands.jsonl").mkdir()
    ended.add(one(1))
    assert ended[1] == one(1)


def test_a_damaged_line_takes_no_other_one_with_it(tmp_path, now):
    file = tmp_path / "commands.jsonl"
    ended = EndedCommands()
    ended.keep_in(file, sync=False)
    for number in (1, 2, 3):
        ended.add(one(number))
    first, second, third = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(first + second.replace(b"{", b"\xff") + third)
    again = EndedCommands()
    again.keep_in(file, sync=False)
    assert [number in again for number in (1, 2, 3)] == [True, False, True]


SHORT = """
import resource, signal, sys
from pathlib import Path
from im_core.clock import wall
from im_pnt_node.journal.ended import EndedCommand, EndedCommands
from im_pnt_node.ros.commands.execute import ended_state

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
file = Path(sys.argv[1])
ended = EndedCommands()
ended.keep_in(file, sync=False)
for number in range(1, 6):
    if number == 2:
        room = file.stat().st_size + 100
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))  # a part of the next line fits
    if number == 4:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    ended.add(EndedCommand(number=number, symbol="pick", time=wall(), success=True, code="ok", message="x" * 200,
                           facts={}, results={}))
assert all(number in ended for number in range(1, 6))
"""


def test_a_line_that_was_cut_short_takes_no_later_one_with_it(tmp_path):
    file = tmp_path / "commands.jsonl"
    subprocess.run([sys.executable, "-c", SHORT, file], check=True)
    again = EndedCommands()
    again.keep_in(file, sync=False)
    assert [number in again for number in range(1, 6)] == [True, False, False, True, True]


@pytest.mark.parametrize(
    ("message", "results", "told"),
    [
        ("", {"report": {"success": True, "message": "expect 0.05 px"}, "directory": "a"}, "expect 0.05 px"),
        ("cancelled", {"report": {"message": "none"}}, "cancelled"),
        ("", {"x": 1.0, "message": "a result of this name", "report": {"message": 3}}, ""),
    ],
)
def test_a_list_of_commands_tells_reports_by_their_messages(message, results, told):
    ended = one(2).model_copy(update={"message": message, "results": results})
    state = ended_state(ended)
    assert state.message == told
    assert json.loads(state.results).keys() == results.keys()
