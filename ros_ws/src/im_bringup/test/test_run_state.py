"""What a machine leaves in its run folder is kept under a name when another begins there."""

import contextlib
from pathlib import Path

import pytest

from im_bringup.machine import run_state
from im_core import unfinished_commands
from im_core.unfinished_commands import OpenCommandNote


def leave(run_dir, content: bytes, commands=()):
    (run_dir / "journal" / "dispatcher").mkdir(parents=True)
    (run_dir / "journal" / "dispatcher" / "000001.journal").write_bytes(content)
    (run_dir / "dom.sqlite").write_bytes(content)
    (run_dir / "dom.sqlite-wal").write_bytes(b"wal")
    unfinished_commands.note(run_dir, "dispatcher", commands)


def test_an_unfinished_mission_that_is_set_aside_is_told_of_and_kept_whole_and_the_next_finds_nothing(tmp_path):
    leave(tmp_path, b"one", [OpenCommandNote("dispatcher", 3, "calibrate_camera")])
    said = []
    run_state.prepare(tmp_path, True, said.append)
    (aside,) = (tmp_path / "missions").iterdir()
    assert (aside / "journal" / "dispatcher" / "000001.journal").read_bytes() == b"one"
    assert [(aside / name).read_bytes() for name in ("dom.sqlite", "dom.sqlite-wal")] == [b"one", b"wal"]
    assert [path.name for path in tmp_path.iterdir()] == ["missions"]
    assert said == [
        "commands had not ended when the machine was: calibrate_camera (number 3 of dispatcher); "
        f"what they have left is kept in {aside}"
    ]
    assert not run_state.prepare(tmp_path, False, said.append)
    assert len(said) == 1, "there is nothing that could be kept"


@pytest.mark.parametrize("killed_after", range(6))
@pytest.mark.parametrize("fresh", [False, True])
def test_a_mission_that_was_half_set_aside_stays_one(tmp_path, monkeypatch, killed_after, fresh):
    leave(tmp_path, b"one", [OpenCommandNote("dispatcher", 3, "calibrate_camera")])
    whole, moved = sorted(path.name for path in tmp_path.iterdir()), []
    rename = Path.rename

    def killed(self, target):
        if len(moved) == killed_after:
            raise KeyboardInterrupt
        moved.append(target)
        return rename(self, target)

    with monkeypatch.context() as patched, contextlib.suppress(KeyboardInterrupt):
        patched.setattr(Path, "rename", killed)
        run_state.prepare(tmp_path, True, lambda _: None)
    said = []
    assert not run_state.prepare(tmp_path, fresh, said.append)
    (aside,) = (tmp_path / "missions").iterdir()
    assert sorted(path.name for path in aside.iterdir()) == whole
    assert [path.name for path in tmp_path.iterdir()] == ["missions"]
    ends = f"calibrate_camera (number 3 of dispatcher); what they have left is kept in {aside}"
    if killed_after < 5:
        assert said == [f"commands had not ended when the machine was: {ends}"]


@pytest.mark.parametrize("fresh", [False, True])
def test_a_mission_that_was_set_aside_whole_and_lost_its_name_does_not_hinder_the_one_after_it(tmp_path, fresh):
    leave(tmp_path / "missions" / "unfinished", b"one", [OpenCommandNote("dispatcher", 3, "home")])
    leave(tmp_path, b"two", [OpenCommandNote("dispatcher", 4, "calibrate_camera")])
    assert run_state.prepare(tmp_path, fresh, lambda _: None) is not fresh
    contents = {path.parent.parent.parent: path.read_bytes() for path in tmp_path.rglob("*.journal")}
    one, *two = sorted((tmp_path / "missions").iterdir(), key=lambda path: path.name.rpartition("-")[2])
    assert contents == {one: b"one", (two[0] if fresh else tmp_path): b"two"}


def test_an_unfinished_mission_is_taken_up_unless_told_otherwise(tmp_path):
    leave(tmp_path, b"one", [OpenCommandNote("dispatcher", 3, "calibrate_camera")])
    said = []
    for _ in range(2):
        assert run_state.prepare(tmp_path, False, said.append)
    assert (tmp_path / "journal" / "dispatcher" / "000001.journal").read_bytes() == b"one"
    assert not (tmp_path / "missions").exists()
    assert said[0].startswith("commands had not ended when the machine was: calibrate_camera (number 3 of dispatcher);")


def test_a_finished_mission_is_kept_where_it_is_said_and_only_the_newest_are(tmp_path):
    said = []
    for number in range(run_state.KEPT + 2):
        leave(tmp_path, bytes([number]))
        assert not run_state.prepare(tmp_path, False, said.append)
    kept = {path: (path / "dom.sqlite").read_bytes()[0] for path in (tmp_path / "missions").iterdir()}
    assert sorted(kept.values()) == list(range(2, run_state.KEPT + 2))
    (newest,) = (path for path, number in kept.items() if number == run_state.KEPT + 1)
    assert said[-1] == f"a new mission begins; data objects and loaded nets of the one before are kept in {newest}"


def test_what_a_machine_knew_that_died_is_there_again_and_not_that_of_one_that_was_stopped(tmp_path):
    said = []
    leave(tmp_path, b"one")
    run_state.begin(tmp_path, "run")
    assert run_state.prepare(tmp_path, False, said.append)
    assert run_state.prepare(tmp_path, False, said.append)  # that start was killed before the machine was ready
    assert (tmp_path / "dom.sqlite").read_bytes() == b"one"
    assert said[0].startswith("the machine before was not stopped but died: its loaded nets and data objects are there")
    run_state.begin(tmp_path, "run")
    run_state.end(tmp_path)
    assert not run_state.prepare(tmp_path, False, said.append)
    leave(tmp_path, b"two")
    run_state.begin(tmp_path, "run")
    assert not run_state.prepare(tmp_path, True, said.append)
    assert not run_state.prepare(tmp_path, False, said.append)
    run_state.end(tmp_path)  # there is nothing to end
    assert not (tmp_path / "dom.sqlite").exists()


def test_a_note_that_is_none_says_nothing(tmp_path):
    unfinished_commands.note(tmp_path, "dispatcher", [])
    assert unfinished_commands.noted(tmp_path) == []
    (tmp_path / "commands" / "dispatcher.json").write_text('[[3, "home"]]')  # of a former version
    assert list(map(str, unfinished_commands.noted(tmp_path))) == ["home (number 3 of dispatcher)"]
    unfinished_commands.note(tmp_path, "dispatcher", [OpenCommandNote("dispatcher", 4, "move", 0.416)])
    assert list(map(str, unfinished_commands.noted(tmp_path))) == ["move (number 4 of dispatcher, 42 %)"]
    for text in ("{", '{"a": 1}', '[["x", 1]]', "[" * 100_000):
        (tmp_path / "commands" / "dispatcher.json").write_text(text)
        assert unfinished_commands.noted(tmp_path) == []
