"""All benchmarks in one table: rows, history and drawing of made-up results, and steps that fail."""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

import bench.page.__main__ as page
from bench.figures import Line, write
from bench.page import docs, history, run
from bench.page.plan import FULL, QUICK, Step, carry_out, chosen
from bench.page.run import LOOP, Row, Run, StepResult, markdown
from im_core.errors import ImError
from im_core.files import FileError

YARDSTICK = [Line(LOOP, 2.0, "s"), Line("load average", 0.1, "", None, "2 processors, made up")]
LIMIT = Line("limit of the command, wall", 10.0, "s", 40.0, "command", bar=0.6, at_least=True)


def step(*lines, part="machine", failure=""):
    rows = [Row.of(line) for line in lines]
    return StepResult(title=f"--{part}", part=part, when=1e9, seconds=3.0, failure=failure, rows=rows)


def made(*steps, commit="0123abcd", when=1e9, yardstick=YARDSTICK):
    rows = [Row.of(line) for line in yardstick]
    return Run(commit=commit, when=when, kind="quick", yardstick=rows, steps=list(steps))


def cells(text, name):
    (row,) = [line for line in text.splitlines() if line.startswith("|") and name in line]
    return [cell.strip() for cell in row.strip("|").split("|")]


def test_a_row_shows_the_figure_its_peer_of_the_same_run_and_a_bar_that_is_missed():
    text = markdown(made(step(LIMIT, Line("stop", 3.0, "s", bar=5.0))))
    assert cells(text, "limit of")[:6] == [
        "limit of the command, wall", "10 s", "command: 40 s", "0.25", "≥ 0.6", "**missed**"
    ]  # fmt: skip
    assert cells(text, "stop")[:6] == ["stop", "3 s", "", "", "≤ 5", "ok"]
    assert "2 figures, 2 with a bar, **1 missed**" in text
    assert cells(text, LOOP)[:2] == [LOOP, "2 s"]


def test_what_could_not_be_measured_says_why_and_cannot_break_the_table():
    text = markdown(made(step(Line("SNAKES", None, "1/s", None, "pip | said:\n<no>", bar=50.0, at_least=True))))
    assert cells(text.replace("\\|", "!"), "SNAKES")[:6] == [
        "SNAKES", "-", "pip ! said: &lt;no>", "", "≥ 50", "not measured"
    ]  # fmt: skip
    assert Row.of(Line("x", float("nan"), "s", 1.0, "bare")).line.measure is None


def test_a_failed_part_is_told_above_and_in_its_place():
    text = markdown(made(step(part="mcs", failure="ended with code -9, without figures"), step(LIMIT)))
    assert "**1 parts failed**: `--mcs`" in text
    assert "**Failed** after 3 s: ended with code -9, without figures" in text
    assert "limit of the command" in text


@pytest.mark.parametrize(("load", "told"), [(0.2, False), (20.0, True)])
def test_a_busy_computer_is_told(load, told):
    yardstick = [YARDSTICK[0], Line("load average", load, "", None, "2 processors, made up")]
    text = markdown(made(step(LIMIT), yardstick=yardstick))
    assert ("wall times say little" in text) == told
    assert "on 2 processors" in text


def test_a_run_comes_back_from_its_file(tmp_path):
    before = made(step(LIMIT))
    file, table = run.write(before, tmp_path / "bench")
    assert run.load(file) == before
    assert table.read_text().endswith(markdown(before))


def test_runs_of_one_commit_make_one_table_with_the_last_of_each_part():
    slower = Line("stop", 9.0, "s", bar=5.0)
    first = made(step(LIMIT), step(slower, part="dom"), when=1e9)
    again = made(step(Line("stop", 3.0, "s", bar=5.0), part="dom"), when=2e9)
    both = run.together([again, first])
    assert [(each.part, each.good) for each in both.steps] == [("machine", False), ("dom", True)]
    assert (both.when, both.kind) == (2e9, "quick; quick")
    with pytest.raises(ImError, match="different commits do not make one table: 0123abcd, other"):
        run.together([first, made(commit="other", when=3e9)])


def test_history_holds_ratios_and_times_in_loops_of_the_yardstick():
    spent = Line("  CPU time of all processes", 40.0, "s", 50.0, "wall time")
    lines = (LIMIT, spent, Line("start, 10 tasks ready", 6.0, "s", bar=15.0))
    grown = history.with_run(history.History(versions=[]), made(step(*lines)))
    (version,) = grown.versions
    limit = {"limit over command (1 is the limit)": 0.25}
    assert version.figures == limit | {"command's CPU [Python loops]": 20.0, "start [Python loops]": 3.0}
    assert (version.load, version.loop_s) == (0.1, 2.0)


def test_history_grows_by_commits_and_keeps_what_a_partial_run_did_not_measure():
    first = history.with_run(history.History(versions=[]), made(step(LIMIT), commit="new", when=2e9))
    older = history.with_run(first, made(step(LIMIT), commit="old", when=1e9))
    again = history.with_run(older, made(step(Line("memory after", 900.0, "MiB")), commit="new", when=3e9))
    assert [version.commit for version in again.versions] == ["old", "new"]
    assert set(again.versions[1].figures) == {"limit over command (1 is the limit)", "memory [MiB]"}


def test_a_missing_history_is_empty_and_a_damaged_one_is_a_sentence(tmp_path):
    path = tmp_path / "performance.json"
    assert history.read(path).versions == []
    grown = history.with_run(history.read(path), made(step(LIMIT)))
    assert history.read(history.write(grown, path)) == grown
    path.write_text(path.read_text()[:-20])
    with pytest.raises(FileError, match=r"performance\.json:\d+:\d+: "):
        history.read(path)
    path.write_text('{"versions": [{"commit": "a", "when": 1, "load": 0, "loop_s": "soon", "figures": {}}]}')
    with pytest.raises(FileError, match=r"performance\.json: versions\[0\]\.loop_s: "):
        history.read(path)


def test_the_drawing_has_a_panel_for_each_figure_and_is_the_same_for_the_same_history(tmp_path):
    grown = history.History(versions=[])
    for number in range(3):
        grown = history.with_run(grown, made(step(LIMIT), commit=f"commit{number}", when=1e9 + number))
    drawings = [history.draw(grown, tmp_path / f"{number}.svg").read_bytes() for number in range(2)]
    assert drawings[0] == drawings[1]
    panels = [each for each in ElementTree.fromstring(drawings[0]).iter() if each.get("id", "").startswith("axes_")]
    assert len(panels) == len(history.FOLLOWED)


def test_the_page_changes_between_its_marks_only(tmp_path, capsys):
    (tmp_path / "images").mkdir()
    file = tmp_path / docs.PAGE
    file.write_text(f"before\n{docs.BEGIN}\nold\n{docs.END}\nafter\n")
    docs.document(made(step(LIMIT)), history.History(versions=[]), tmp_path)
    assert "not measured in this run: command's CPU" in capsys.readouterr().out
    text = file.read_text()
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text
    assert "limit of the command" in text
    assert len(history.read(tmp_path / docs.HISTORY).versions) == 1
    file.write_text("no marks")
    with pytest.raises(FileError, match="lacks the lines"):
        docs.document(made(step(LIMIT)), history.History(versions=[]), tmp_path)
    assert file.read_text() == "no marks"


PROGRAM = """
import os, shutil, sys, time
{}
shutil.copy(os.environ["MADE_LINES"], sys.argv[sys.argv.index("--lines") + 1])
"""


@pytest.mark.parametrize(
    ("does", "failure"),
    [
        ("", ""),
        ("sys.exit('there is no light')", "ended with code 1, without figures: there is no light"),
        ("os.kill(os.getpid(), 9)", "ended with code -9, without figures: it says nothing"),
        ("time.sleep(100)", "not done after 2 s"),
    ],
)
def test_a_step_that_does_not_work_is_part_of_the_result(tmp_path, monkeypatch, does, failure):
    write(tmp_path / "lines.json", [LIMIT])
    monkeypatch.setenv("MADE_LINES", str(tmp_path / "lines.json"))
    limit_s = 2.0 if "sleep" in does else 100.0
    result = carry_out(Step("made_up", ("--quick",), limit_s), (sys.executable, "-S", "-c", PROGRAM.format(does)))
    assert result.failure == failure
    assert [row.line for row in result.rows] == ([] if failure else [LIMIT])
    assert result.title == "--made_up --quick"


def test_a_group_that_failed_is_counted_and_is_no_success():
    silent = step(Line("lockstep", None, "", None, "the servo is not ready")).model_copy(update={"code": 1})
    assert not silent.good
    assert "**1 could not be measured**" in markdown(made(silent))


def test_every_part_is_there_and_an_unknown_one_is_refused():
    for each in {*QUICK, *FULL}:
        assert (Path(page.__file__).parents[1] / each.part / "__main__.py").is_file()
    assert [each.part for each in chosen(QUICK, ["dom", "mcs"])] == ["mcs", "dom"]
    with pytest.raises(ImError, match="--only quux: there is no such part; there are bag, calibration, "):
        chosen(QUICK, ["quux"])


@pytest.fixture
def measuring(tmp_path, monkeypatch):
    """The command, without the computer: steps are made up by part."""
    results = {each.part: step(LIMIT, part=each.part) for each in QUICK}

    def carry(each):
        found = results[each.part]
        if isinstance(found, BaseException):
            raise found
        return found

    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    monkeypatch.setattr(page, "interrupt_once", lambda: None)
    monkeypatch.setattr(page, "carry_out", carry)
    monkeypatch.setattr(page.yardstick, "lines", lambda: YARDSTICK)
    return results


def kept(tmp_path):
    (file,) = (tmp_path / "bench").glob("*.json")
    return run.load(file)


def test_all_parts_are_measured_though_one_fails_and_the_exit_code_tells(tmp_path, measuring, capsys):
    measuring["mcs"] = step(part="mcs", failure="ended with code 1, without figures: no servo")
    assert page.main(["--quick"]) == 1
    assert [each.part for each in kept(tmp_path).steps] == [each.part for each in QUICK]
    told = capsys.readouterr()
    assert "failed: ended with code 1, without figures: no servo" in told.out
    assert (
        f"all in all: {len(QUICK) - 1} bars are missed, 0 figures could not be measured, 1 of {len(QUICK)} parts failed"
        in told.out
    )


def test_met_bars_are_a_success_and_a_former_run_can_be_shown_again(tmp_path, measuring, capsys):
    for part in measuring:
        measuring[part] = step(Line("stop", 3.0, "s", bar=5.0), part=part)
    assert page.main(["--quick", "--only", "dom"]) == 0
    assert kept(tmp_path).kind == "quick, only dom"
    (file,) = (tmp_path / "bench").glob("*.json")
    capsys.readouterr()
    assert page.main(["--from", str(file)]) == 0
    assert "stop" in capsys.readouterr().out


def test_what_was_measured_before_an_interruption_is_kept(tmp_path, measuring):
    measuring[QUICK[2].part] = KeyboardInterrupt()
    assert page.main(["--quick"]) == 130
    assert [each.part for each in kept(tmp_path).steps] == [each.part for each in QUICK[:2]]
    assert kept(tmp_path).kind == f"quick, interrupted after 2 of {len(QUICK)} parts"


@pytest.mark.parametrize("content", ["", "[]", json.dumps({"commit": 3})])
def test_a_damaged_run_is_refused_with_a_sentence(tmp_path, measuring, content, capsys):
    file = tmp_path / "run.json"
    file.write_text(content)
    with pytest.raises(SystemExit, match="2"):
        page.main(["--from", str(file)])
    assert f"bench: error: {file}" in capsys.readouterr().err
    assert not (tmp_path / "bench").exists()
