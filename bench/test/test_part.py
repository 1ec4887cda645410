"""What every part of the benchmarks does alike."""

import json
import sys
from argparse import ArgumentTypeError

import pytest

import bench.part
from bench.calibration import __main__ as calibration
from bench.chaos import __main__ as chaos
from bench.dom import __main__ as dom
from bench.figures import Line
from bench.fuzz import __main__ as fuzz
from bench.machine import __main__ as machine
from bench.mcs import __main__ as mcs
from bench.nets import __main__ as nets
from bench.part import Part, positive
from bench.sizes import __main__ as sizes
from bench.soak import __main__ as soak
from bench.spot import __main__ as spot
from bench.vss import __main__ as vss
from im_core.errors import ImError, StateError

GROUPS = {"one": "the first", "two": "the second"}


@pytest.fixture(autouse=True)
def _keep_signals(monkeypatch):
    monkeypatch.setattr(bench.part, "interrupt_once", lambda: None)


def part(*usual):
    return Part("made_up", "Measures what is made up.", GROUPS, usual)


def failing():
    raise StateError("there is nothing to measure")


def ways(**kept):
    def work(options, folder):
        assert folder.is_dir()
        return {"one": lambda: [Line("first", 2.0, "s", 1.0, "bare", bar=3.0)], "two": failing, **kept}

    return work


def test_figures_go_to_the_file_alone_with_their_verdicts(tmp_path, capsys):
    file = tmp_path / "lines.json"
    assert part().run(ways(), ["one", "--lines", str(file)]) == 0
    assert "first" not in capsys.readouterr().out
    row = next(row for row in json.loads(file.read_text()) if row["name"] == "first")
    assert (row["measure"], row["met"]) == (2.0, True)


def test_a_group_that_fails_is_a_row_with_its_reason_and_the_others_are_measured(tmp_path):
    file = tmp_path / "lines.json"
    assert part().run(ways(), ["two", "one", "--lines", str(file)]) == 1
    rows = {row["name"]: row for row in json.loads(file.read_text())}
    assert rows["first"]["value"] == 2.0
    assert (rows["two"]["value"], rows["two"]["against"]) == (None, "there is nothing to measure")


def test_a_missed_bar_is_told_and_is_the_exit_code(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    assert part().run(ways(one=lambda: [Line("first", 4.0, "s", 1.0, "bare", bar=3.0)]), ["one"]) == 1
    assert "MISSED" in capsys.readouterr().out
    assert len(list(tmp_path.glob("bench-made_up-*.json"))) == 1


def test_only_the_usual_groups_are_measured_where_none_is_named(tmp_path):
    file = tmp_path / "lines.json"
    assert part("one").run(ways(), ["--lines", str(file)]) == 0
    assert part().run(ways(), ["--lines", str(file)]) == 1


def test_what_is_wrong_with_the_options_is_bad_usage(capsys):
    def refuse(options, folder):
        raise ImError("mcs.yaml:3: there is no such slot")

    with pytest.raises(SystemExit, match="2"):
        part().run(ways(), ["three"])
    assert "there is no group 'three'; there are one, two" in capsys.readouterr().err
    assert part().run(refuse, []) == 2
    assert "no such slot" in capsys.readouterr().err


def test_an_interruption_has_a_code_of_its_own(capsys):
    def interrupted():
        raise KeyboardInterrupt

    assert part().run(ways(one=interrupted), ["one"]) == 130
    assert "interrupted" in capsys.readouterr().err


PARTS = [calibration, dom, machine, mcs, nets, sizes, soak, spot, vss]


@pytest.mark.parametrize("each", PARTS, ids=lambda each: each.__package__)
def test_every_group_that_help_tells_of_can_be_measured(each, monkeypatch, tmp_path):
    def look(self, work, arguments=None):
        return work(self.parser.parse_args([]), tmp_path)

    monkeypatch.setattr(Part, "run", look)
    assert set(each.main()) == set(each.GROUPS)


@pytest.mark.parametrize("text", ["0", "-1", "nan"])
def test_numbers_that_must_be_above_zero_are_refused_otherwise(text):
    with pytest.raises(ArgumentTypeError, match=f"{text} must be above 0"):
        positive(float)(text)


@pytest.mark.parametrize(
    ("command", "option"),
    [(chaos, "--injections"), (chaos, "--minutes"), (dom, "--kills"), (fuzz, "--rounds"), (fuzz, "--clients")],
    ids=str,
)
def test_numbers_of_what_is_to_be_done_are_above_zero(command, option, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bench", option, "-1"])
    with pytest.raises(SystemExit, match="2"):
        command.main()
    assert f"argument {option}: -1 must be above 0" in capsys.readouterr().err
