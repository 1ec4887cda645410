"""One start at a time: the mark, whose it is when it is taken, and how ``stop`` asks a start to end."""

import os
import re
import socket
import threading
from types import SimpleNamespace

import pytest

from im_bringup.machine import start, start_mark, stop
from im_bringup.machine.machine_state import MachineRecord
from im_bringup.machine.start_mark import end_start, only_one
from im_core import clock
from im_core.errors import StateError


@pytest.fixture(autouse=True)
def domain(monkeypatch):
    """A ROS domain of the test's own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(30_000 + os.getpid()))
    return 30_000 + os.getpid()


def test_of_two_starts_at_once_the_second_is_refused(domain):
    sentence = f"another start of ROS domain {domain} is under way (process {os.getpid()}); wait for it, or set another"
    with only_one(), pytest.raises(StateError, match=f"^{re.escape(sentence)}"), only_one():
        pass
    with only_one():
        pass


def test_a_mark_that_another_user_has_taken_is_said_to_be_that(domain, monkeypatch):
    """This process takes itself for another user than the one that has taken the mark, which the kernel tells."""
    mine = os.geteuid()
    held = f"the name @im{domain}_start, which a start of ROS domain {domain} takes, is held by process {os.getpid()}"
    sentence = rf"^{held} of user {mine}\b.*, not by one of yours; have that process ended, or set another ROS_DOM"
    with only_one() as held:
        monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
        with pytest.raises(StateError, match=sentence), only_one():
            pass
        assert not end_start()
        assert not held.stop_asked()


def test_a_mark_that_nobody_answers_for_is_no_start_that_is_under_way():
    sentence = r"is held by a process that does not answer \(ss -xlp shows it\); have that process ended, or set "
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as squatter:
        squatter.bind(start_mark._name())
        with pytest.raises(StateError, match=sentence), only_one():
            pass
        assert not end_start()


def test_without_a_start_there_is_none_to_end():
    assert not end_start()


def test_stop_ends_a_start_that_is_under_way_and_both_say_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(start.stop, "stop", lambda say: 0)
    monkeypatch.setattr(stop, "ignore_interrupts", lambda: None)
    monkeypatch.setattr("sys.argv", ["stop"])
    begun, said = threading.Event(), []

    class Running:
        def poll(self):
            begun.set()

    def run():
        try:
            with only_one() as mark:
                start.await_ready(Running(), clock.monotonic(), 60.0, {}, False, mark.stop_asked)
        except StateError as error:
            said.append(error.message)

    starting = threading.Thread(target=run)
    starting.start()
    assert begun.wait(60.0)
    assert stop.main() == 0
    starting.join(60.0)
    assert said == ["the machine was stopped while it started"]
    assert capsys.readouterr().out == "stop: a start was under way, and has ended\n"


def test_a_start_tells_its_steps_and_one_that_takes_too_long_how_to_allow_more(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(start.stop, "stop", lambda say: 0)
    monkeypatch.setattr(clock, "sleep", lambda _: None)
    seen = [("LOAD", {}), ("CONFIGURE", {"load": 1.0}), *[("CONFIGURE", {"load": 1.0, "configure": 1.0})] * 3]
    left = [MachineRecord(2, 0, start.machine.STARTING, phase, 3, "", "", 0.0, 1, 0, took=took) for phase, took in seen]
    monkeypatch.setattr(start.machine, "read", lambda: left.pop(0) if len(left) > 1 else left[0])
    monkeypatch.setattr(clock, "monotonic", lambda: 0.0 if len(left) > 1 else 60.0)
    assert start.await_ready(SimpleNamespace(poll=lambda: None), 0.0, 60.0, {"preflight": 0.0}, False) is None
    told = capsys.readouterr()
    steps = ["load 3 tasks", "configure 3 tasks", "verify the nets together"]
    assert told.out.splitlines() == [f"start: {step}" for step in steps]
    assert "not every task was ready after 60 s (--timeout allows more):" in told.err


def test_a_bootstrap_that_ended_in_order_was_stopped():
    ended = SimpleNamespace(poll=lambda: 0)
    with pytest.raises(StateError, match=r"^the machine was stopped while it started$"):
        start.await_ready(ended, clock.monotonic(), 60.0, {}, False)
