"""The benchmark's own arithmetic: work in turns, steps of a frame, and what it says when it cannot measure."""

import sys

import pytest

from bench.vss import __main__ as bench
from bench.vss import cameras
from bench.vss.cameras import Turns, step_lines, take_turns
from im_core import clock
from im_core.errors import ImError


def test_work_in_turns_is_counted_without_its_first_run(monkeypatch):
    monkeypatch.setattr(cameras, "_TURN_S", 0.01)
    calls = []

    def work():
        calls.append(clock.monotonic())
        clock.sleep(0.002)

    turns = Turns(work, 5, lambda: {"render_s": 0.25})
    take_turns([turns])
    counted = len(calls) - cameras._ROUNDS
    assert counted > 0
    assert turns.steps["render_s"] == pytest.approx(0.25 * cameras._ROUNDS / (5 * counted))
    assert 0.0 < turns.rate < 5.0 / 0.002


def test_short_steps_are_left_out_and_the_longest_comes_first():
    lines = step_lines({"warp_s": 0.02, "render_s": 0.07, "plates_s": 0.0005}, 0.1, "frame")
    assert [(line.name.strip(), line.measure) for line in lines] == [
        ("render", pytest.approx(0.7)),
        ("warp", pytest.approx(0.2)),
    ]


def test_a_renderer_that_fails_is_a_line_that_says_why(monkeypatch, capsys):
    def missing(*_):
        raise ImError("renderer 'egl' does not load on this host")

    monkeypatch.setattr(cameras, "lines", missing)
    (line,) = bench._or_why("egl", cameras.lines)
    assert (line.name, line.value, line.against) == ("egl", None, "renderer 'egl' does not load on this host")
    monkeypatch.setattr(sys, "argv", ["bench", "framse"])
    with pytest.raises(SystemExit, match="2"):
        bench.main()
    assert "there is no group 'framse'; there are cameras, frames, coverage, services" in capsys.readouterr().err
