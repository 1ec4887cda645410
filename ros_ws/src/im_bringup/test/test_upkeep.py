"""Nothing grows without bound, and nothing that is not ours, or is the newest, is removed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_bringup.tasks.upkeep import Keep, Upkeep, prune, prune_tool_logs, rotate, surplus
from im_core.processes.process import last_words

DAY = 86_400.0
NOW = 1_800_000_000.0


def result(folder, name, age_days, files=("report.json",)):
    path = folder / name
    path.mkdir(parents=True)
    for file in files:
        (path / file).write_text("{}")
    os.utime(path, (NOW - age_days * DAY, NOW - age_days * DAY))
    return path


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_results_are_kept_by_number(tmp_path):
    for number in range(5):
        result(tmp_path, f"20260101-00000{number}", 10 - number)
    assert [path.name for path in prune(tmp_path, Keep(results=2), (), NOW)] == [
        "20260101-000002",
        "20260101-000001",
        "20260101-000000",
    ]
    assert names(tmp_path) == ["20260101-000003", "20260101-000004"]


def test_results_are_kept_by_age_but_never_the_newest_nor_what_is_in_use(tmp_path):
    used = result(tmp_path, "20240101-000000", 700)
    latest = result(tmp_path, "20240601-000000", 500)
    result(tmp_path, "20240701-000000-2", 450)
    newest = result(tmp_path, "20240801-000000", 400)
    (tmp_path / "latest").symlink_to(latest.name)
    prune(tmp_path, Keep(days=365), [used], NOW)
    assert names(tmp_path) == sorted([used.name, latest.name, newest.name, "latest"])


def test_what_is_not_ours_stays(tmp_path):
    theirs = [
        result(tmp_path, "my_own_folder", 900),
        result(tmp_path, "20200101-000000", 901, files=["thesis.tex"]),
        result(tmp_path / "vss", "im0-20200101-000000", 902, files=["wall.yaml"]),
    ]
    (theirs[2] / "notes").mkdir()
    os.utime(theirs[2], (0, 0))
    (tmp_path / "bench-20200101-000000.json").write_text("[]")
    outside = result(tmp_path / "elsewhere", "20200101-000001", 903)
    (tmp_path / "20200101-000002").symlink_to(outside)
    before = sorted(tmp_path.rglob("*"))
    result(tmp_path, "20260101-000000", 1)
    result(tmp_path / "vss", "im0-20260101-000000", 1, files=["wall.yaml"])
    assert prune(tmp_path, Keep(results=1, days=1), (), NOW) == []
    assert set(before) <= set(tmp_path.rglob("*"))


def test_calibrations_and_evidence_are_bounded_too(tmp_path):
    for number in range(4):
        result(tmp_path / "vss", f"im7-20260101-00000{number}", 10 - number, files=["wall.yaml"])
    (tmp_path / "mcs").mkdir()
    for number in range(4):
        began = "20260101-000000_" if number else ""  # without it: as written before names had a time
        path = tmp_path / "mcs" / f"{began}00000000{number}_limit.npz"
        path.write_bytes(b"x")
        os.utime(path, (NOW - 10 + number, NOW - 10 + number))
    assert len(prune(tmp_path, Keep(results=1), (), NOW)) == 6
    left = (["im7-20260101-000003"], ["20260101-000000_000000003_limit.npz"])
    assert (names(tmp_path / "vss"), names(tmp_path / "mcs")) == left


@given(st.lists(st.floats(0.0, 1000.0), max_size=30), st.integers(1, 10), st.floats(0.1, 500.0))
def test_the_newest_always_stays_and_no_more_than_asked_for(ages, count, days):
    found = [(Path(str(number)), NOW - age * DAY) for number, age in enumerate(ages)]
    gone = surplus(found, Keep(results=count, days=days), NOW)
    kept = [(path, time) for path, time in found if path not in gone]
    assert len(set(gone)) == len(gone)
    assert len(kept) <= count
    if found:
        newest = max(time for _, time in found)
        assert newest in [time for _, time in kept]
        assert all(NOW - time <= days * DAY or time == newest for _, time in kept)


WRITER = """
import sys
for line in sys.stdin:
    print(line.strip() * 100, flush=True)
    print("done", file=sys.stderr, flush=True)
"""


def test_a_log_is_rotated_while_its_process_writes_into_it(tmp_path):
    log = tmp_path / "task.log"
    with log.open("ab") as output:
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER], stdin=subprocess.PIPE, stdout=output, stderr=subprocess.PIPE, text=True
        )
    try:
        for number in range(6):
            writer.stdin.write(f"{number}\n")
            writer.stdin.flush()
            writer.stderr.readline()
            rotate(log, 150.0)
    finally:
        writer.stdin.close()
        writer.wait(60)
        writer.stderr.close()
    assert (tmp_path / "task.log.1").read_text() == "".join(str(n) * 100 + "\n" for n in (4, 5))
    assert log.read_bytes() == b""


def test_what_is_written_while_a_log_is_rotated_is_kept(tmp_path, monkeypatch):
    log = tmp_path / "task.log"
    log.write_text("first\n")
    replace = Path.replace

    def slow(path, target):
        with log.open("a") as output:
            output.write("meanwhile\n" * 300_000)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", slow)
    assert rotate(log, 1.0)
    assert (tmp_path / "task.log.1").read_text() == "first\n" + "meanwhile\n" * 300_000
    assert log.read_bytes() == b""


def test_where_there_is_no_room_for_the_old_log_it_stays(tmp_path, monkeypatch):
    log = tmp_path / "task.log"
    log.write_text("x" * 100)
    (tmp_path / "task.log.1").write_text("of before")

    def no_room(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("shutil.copyfileobj", no_room)
    with pytest.raises(OSError, match="No space left"):
        rotate(log, 10.0)
    assert log.read_text() == "x" * 100
    assert names(tmp_path) == ["task.log", "task.log.1"]
    assert (tmp_path / "task.log.1").read_text() == "of before"
    said = []
    upkeep = Upkeep(tmp_path, tmp_path, Keep(log_mib=1e-6), (), said.append)
    upkeep.rotate_logs()
    upkeep.rotate_logs()
    assert said == ["upkeep: [Errno 28] No space left on device"]


def test_the_last_words_of_a_log_that_was_rotated_are_found(tmp_path):
    log = tmp_path / "task.log"
    log.write_text("first\nwhy it ended\n")
    assert last_words(log, begin=10_000) == "why it ended"
    assert last_words(log, begin=log.stat().st_size) == ""


def test_of_the_logs_of_tools_the_newest_stay(tmp_path):
    for number in range(5):
        path = tmp_path / f"python_{number}.log"
        path.write_text("x")
        os.utime(path, (number, number))
    (tmp_path / "mine.txt").write_text("x")
    prune_tool_logs(tmp_path, most=2)
    assert names(tmp_path) == ["mine.txt", "python_3.log", "python_4.log"]


def test_the_thread_ends_when_it_is_asked_to(tmp_path):
    upkeep = Upkeep(tmp_path, tmp_path, Keep(), (), print)
    upkeep.start()
    upkeep.stop()
    upkeep._thread.join(60.0)
    assert not upkeep._thread.is_alive()
