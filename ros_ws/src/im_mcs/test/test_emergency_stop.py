"""An emergency stop with a thousand goals in the queue: power, mark, answer, then the ends of the goals."""

import threading

import numpy as np
import pytest

from im_core.errors import StateError, StoreError
from im_mcs.client.emergency_stop import EmergencyStop
from im_mcs.protocol.channel import evidence_type
from im_mcs.protocol.evidence import KEPT, Recorder
from im_mcs.safety.stop_mark import StopLatch, StopMark
from im_mcs.servo.core import Mcs
from im_mcs.state import State
from im_mcs.testbed.driver import PowerReading

GOALS, CAUSE = 1000, "somebody asked for it"


class Circuits:
    """Stop circuits of hardware that obeys at once."""

    def __init__(self):
        self.is_it_cut = False
        self.on_cut = lambda: None

    def cut(self):
        self.is_it_cut = True
        self.on_cut()
        return "the stop circuit of testbed is cut"

    def restore(self):
        self.is_it_cut = False

    def reading(self):
        return PowerReading(not self.is_it_cut, self.is_it_cut)


@pytest.fixture
def latch(monkeypatch, tmp_path):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    return StopLatch(Circuits())


class Told(list):
    """What MCS tells, each with the power at that moment and the mark."""

    def __init__(self, driver):
        super().__init__()
        self.driver = driver

    def append(self, message):
        super().append((message, self.driver.drive.power, StopMark().read()))


def stopping_bench(bench, latch):
    """The bench again, with a latch."""
    bench.events = told = Told(bench.driver)
    recorder = Recorder(np.zeros(KEPT, evidence_type(bench.mcs.config)))
    bench.mcs = Mcs(bench.mcs.config, bench.mcs.model, bench.testbed, lambda m: told.append(m), recorder, latch=latch)
    bench.reply = lambda number: next((m for m, _, _ in told if m["event"] == "reply" and m["id"] == number), None)
    return bench


def test_power_goes_and_the_mark_is_kept_before_any_of_a_thousand_goals_ends(bench, latch, cell):
    bench = stopping_bench(bench, latch)
    bench.to_motion("left")
    path = {"kind": "joint", "points": [(cell.home[:9] + 0.1).tolist()], "blend": 0.0}
    moves = {"group": "left", "path": path, "policy": "append"}
    bench.mcs.tick([{"id": 100 + k, "request": "move", "arguments": moves} for k in range(GOALS)])
    bench.mcs.tick([])
    bench.events.clear()
    bench.mcs.tick([{"id": 99, "request": "estop", "arguments": {"reason": CAUSE}}])
    answer, *ends = [told for told in bench.events if told[0]["event"] == "reply"]
    assert answer[0]["id"] == 99
    assert [message["id"] for message, _, _ in ends] == [100 + k for k in range(GOALS)]
    assert all((power, mark) == (False, CAUSE) for _, power, mark in ends)
    assert {message["results"]["evidence"] for message, _, _ in ends} == {1}, "they share one piece of evidence"


def test_a_stop_by_a_watch_is_kept_too(bench, latch):
    bench = stopping_bench(bench, latch)
    bench.to_motion("left")
    bench.driver.q[3] = np.nan
    bench.mcs.tick([])
    assert bench.mcs.manager.state is State.ESTOPPED
    assert StopMark().read() == bench.mcs.manager.cause
    assert "left_j1" in StopMark().read()


def test_mcs_begins_estopped_where_a_stop_is_kept_until_it_is_reset(bench, latch):
    latch.keep(CAUSE)
    bench = stopping_bench(bench, latch)
    assert (bench.mcs.manager.state, bench.mcs.manager.cause) == (State.ESTOPPED, CAUSE)
    assert "is refused in state estopped" in bench.ask("reserve", group="left")["error"]["message"]
    assert bench.ask("reset")["success"]
    assert StopMark().read() == ""
    bench.to_motion("left")


def test_a_mark_that_cannot_be_removed_refuses_the_reset(bench, latch, monkeypatch):
    latch.keep(CAUSE)
    bench = stopping_bench(bench, latch)

    def refuse(_):
        raise StoreError("read-only file system", file="estop", reason="read-only file system")

    monkeypatch.setattr(StopMark, "clear", refuse)
    assert "read-only file system" in bench.ask("reset")["error"]["message"]
    assert bench.mcs.manager.state is State.ESTOPPED


def test_a_mark_that_cannot_be_made_has_the_circuits_cut(latch, monkeypatch, tmp_path):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()
    monkeypatch.setattr(StopMark, "path", tmp_path / "no_folder" / "estop")
    said = latch.keep(CAUSE)
    assert said.startswith("the emergency stop cannot be kept in the run folder: ")
    assert said.endswith("the stop circuit of testbed is cut")


def test_a_full_disk_keeps_the_mark_without_its_cause(latch, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("im_core.files.os.write", full)
    assert latch.keep(CAUSE) == ""
    assert StopMark().read() == "an emergency stop"


def test_power_is_cut_before_the_mark_and_both_before_the_answer(latch):
    circuits, seen = Circuits(), []
    circuits.on_cut = lambda: seen.append(StopMark().read())
    stop = EmergencyStop(circuits, latch)
    said = stop.stop(CAUSE, None)
    assert seen == ["", ""], "the circuits were cut first"
    assert said == "the stop circuit of testbed is cut; power is off, every brake holds"
    assert StopMark().read() == stop.cause == CAUSE


def test_a_stop_during_a_reset_stays(latch):
    stop = EmergencyStop(Circuits(), latch)
    stop.stop(CAUSE, None)
    count = stop.count
    again = threading.Thread(target=stop.stop, args=("once more", None))
    again.start()
    again.join()
    with pytest.raises(StateError, match="overtaken by another emergency stop"):
        stop.end(count, forget=True)
    assert stop.cause == StopMark().read() == CAUSE
    stop.end(stop.count, forget=True)
    assert stop.cause == StopMark().read() == ""


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (PowerReading(True, False), "power is still on after 0.2 s"),
        (PowerReading(False, False), "power is off, not every brake holds yet"),
        (None, "nobody reports whether the power is off"),
    ],
)
def test_the_answer_says_what_is_so(latch, reading, words):
    circuits = Circuits()
    circuits.reading = lambda: reading
    assert words in EmergencyStop(circuits, latch).stop(CAUSE, None)
