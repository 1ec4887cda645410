import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from im_bringup.machine import machine_state as machine
from im_bringup.machine import start
from im_bringup.machine.machine_state import MachineRecord
from im_core import names
from im_core.errors import DataError, LinkError, StateError
from im_core.processes.procfs import ProcessId


@pytest.fixture(autouse=True)
def domain(monkeypatch):
    """A ROS domain of the test's own; its record is removed."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(10_000 + os.getpid()))
    yield
    machine.remove()


def record(process):
    return MachineRecord(process.pid, process.start, machine.READY, "START", 3, "/run", "d.yaml", 0.0, 1, 8080, ["x"])


def test_a_record_comes_back_as_it_was_written():
    assert machine.read() is None
    written = record(ProcessId.current())
    machine.write(written)
    assert machine.read() == written
    assert machine.runs_here()
    machine.remove()
    assert machine.read() is None


def test_the_record_of_a_dead_bootstrap_is_not_a_running_machine():
    current = ProcessId.current()
    machine.write(record(ProcessId(current.pid, current.start - 1)))  # the same pid, used by an earlier process
    assert not machine.runs_here()


@pytest.mark.parametrize("text", ["", "[]", json.dumps({"pid": 1}), "{"])
def test_a_damaged_record_is_an_error_with_its_name(text):
    machine.record_path().write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match="is not the record of a machine"):
        machine.read()


def test_neither_a_link_nor_a_file_of_another_user_is_taken_for_a_record(tmp_path, monkeypatch):
    """A link would have root write over its target, a record of another user keep every start away."""
    target, mine = tmp_path / "target", os.geteuid()
    target.write_text("precious")
    machine.record_path().symlink_to(target)
    with pytest.raises(DataError, match=r"is not the record of a machine: cannot be read: Too many levels of symbo"):
        machine.read()
    machine.write(record(ProcessId.current()))
    assert target.read_text() == "precious"
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    refused = pytest.raises(LinkError, match=f"^{machine.record_path()} belongs to user {mine}.*, not to you; remove")
    for use in (machine.read, start.require_none_runs, lambda: machine.write(record(ProcessId.current()))):
        with refused:
            use()
    machine.remove()
    assert machine.record_path().exists()


def test_start_prints_the_address_that_the_display_has_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    start.print_ready(record(ProcessId.current()), 1.0)
    assert "http" not in capsys.readouterr().out
    names.display_file().write_text("http://127.0.0.1:8083/\n")
    start.print_ready(record(ProcessId.current()), 1.0)
    assert "nets at http://127.0.0.1:8083/, logs in" in capsys.readouterr().out


def test_a_folder_in_which_a_machine_of_another_domain_runs_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    mine, other = machine.record_path(), Path(f"/dev/shm/im{20_000_000 + os.getpid()}_machine.json")
    current = ProcessId.current()
    machine.write(replace(record(current), run_dir=str(tmp_path)))
    try:
        mine.rename(other)
        with pytest.raises(StateError, match=f"the machine {other.name.split('_')[0]} runs with the folder {tmp_path}"):
            start.require_none_runs()
        other.write_text("no record", encoding="utf-8")
        start.require_none_runs()
        machine.write(replace(record(ProcessId(current.pid, current.start - 1)), run_dir=str(tmp_path)))
        mine.rename(other)
        start.require_none_runs()  # that one has ended
    finally:
        other.unlink(missing_ok=True)


def interrupted(*_):
    """Stands for a function during which Ctrl-C comes."""
    raise KeyboardInterrupt


@pytest.fixture
def nothing_started(tmp_path, monkeypatch):
    """A start without effects; what comes between is the test's. Returns the calls of stop."""
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(start, "interrupt_once", lambda: None)
    for name in ("check_calibration", "preflight.check_host", "clear_the_way", "tidy", "spawn_bootstrap"):
        monkeypatch.setattr(f"im_bringup.machine.start.{name}", lambda *_: None)
    stopped = []
    monkeypatch.setattr(start.stop, "stop", lambda say: stopped.append(say) or 0)
    return stopped


@pytest.mark.parametrize(
    ("where", "stops"),
    [
        ("deployments.load", 0),
        ("check_calibration", 0),
        ("machine.read", 0),
        ("preflight.check_host", 0),
        ("clear_the_way", 1),
        ("spawn_bootstrap", 1),
        ("await_ready", 1),
    ],
)
def test_an_interrupted_start_stops_only_what_it_began(where, stops, nothing_started, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["start"])
    monkeypatch.setattr(f"im_bringup.machine.start.{where}", interrupted)
    assert start.main() == 130
    assert len(nothing_started) == stops
    assert ("stopping what was started" in capsys.readouterr().err) == bool(stops)


@pytest.mark.parametrize("where", ["print_ready", "print_parts", "attend"])
def test_an_interrupt_of_a_ready_machine_in_the_foreground_ends_it_in_order(
    where, nothing_started, monkeypatch, capsys
):
    monkeypatch.setattr("sys.argv", ["start", "--foreground"])
    monkeypatch.setattr("im_bringup.machine.start.await_ready", lambda *_: record(ProcessId.current()))
    monkeypatch.setattr("im_bringup.machine.start.attend", lambda _: 0)
    monkeypatch.setattr(f"im_bringup.machine.start.{where}", interrupted)
    assert start.main() == 0
    assert nothing_started == [start.say]
    assert "stopping the machine" in capsys.readouterr().err


def test_interrupts_are_ignored_before_a_ready_machine_is_told_of(nothing_started, monkeypatch, capsys):
    """An interrupt that came later would take back what the exit code says; the caller decides what to do about it."""
    monkeypatch.setattr("sys.argv", ["start"])
    said = []
    monkeypatch.setattr("im_bringup.machine.start.await_ready", lambda *_: record(ProcessId.current()))
    monkeypatch.setattr(start, "ignore_interrupts", lambda: said.append("ready" in capsys.readouterr().out))
    assert start.main() == 0
    assert (said, nothing_started) == ([False], [])
    assert "start: ready after" in capsys.readouterr().out
