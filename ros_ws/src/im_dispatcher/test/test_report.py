"""Reports on disk and where the time went."""

import json
from pathlib import Path

import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate, report_of
from im_core.errors import DataError
from im_dispatcher.report import (
    MOST_STARTED,
    StepTimes,
    failed,
    make_directory,
    succeeded,
    write_report,
)


def test_latest_points_to_the_newest_report(tmp_path: Path) -> None:
    for number in (1, 2):
        write_report(make_directory(tmp_path, "20260101-000000"), {"number": number})
    assert json.loads((tmp_path / "latest" / "report.json").read_text())["number"] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["20260101-000000", "20260101-000000-1", "latest"]


def test_a_report_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    directory = make_directory(tmp_path, "a")
    write_report(directory, {"number": 1})
    with pytest.raises(ValueError, match="JSON compliant"):
        write_report(directory, {"number": float("nan")})
    assert json.loads((directory / "report.json").read_text()) == {"number": 1}


def test_the_summary_counts_the_poses_of_the_command(tmp_path: Path) -> None:
    """The solver was not told of those that were skipped."""
    problem = make_scene(Design(), 1).problem
    solver = report_of(calibrate(problem), problem)
    skipped = [{"pose": "p41", "camera": "", "reason": "out of reach"}, {"pose": "p42", "camera": "", "reason": "dark"}]
    write_report(make_directory(tmp_path, "a"), succeeded(solver, skipped, 42))
    text = (tmp_path / "latest" / "summary.txt").read_text()
    assert "poses used          40 of 42" in text
    assert "2 observations rejected" in text
    assert "pose p41: out of reach" in text


def test_a_report_that_is_not_whole_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the report of the calibration is not whole"):
        write_report(make_directory(tmp_path, "a"), {"message": "done", "cameras": [{"name": "wall"}]})
    assert not list((tmp_path / "a").iterdir())


def test_times_add_up_by_step() -> None:
    times = StepTimes()
    for start in (1.0, 5.0):
        times.note_start("net.move", 0, start)
        times.note_end("net.move", 0, start + 2.0, 0.5)
    times.note_start("net.instant", 0, 9.0)
    times.note_end("net.instant", 0, 9.0, 0.0)
    summary = times.summary(wall_s=2.0, simulated_s=10.0)
    assert summary["simulated_over_wall"] == 5.0
    assert summary["steps"] == {"net.move": {"count": 2, "wall_s": 1.0, "simulated_s": 4.0}}


def test_times_go_on_where_a_former_life_ended() -> None:
    former, present = StepTimes(), StepTimes()
    for times, wall_s in ((former, 0.5), (present, 0.25)):
        times.note_start("net.move", 0, 1.0)
        times.note_end("net.move", 0, 3.0, wall_s)
    present.add_times(json.loads(json.dumps(former.to_dict())))
    summary = present.summary(wall_s=2.0, simulated_s=10.0)
    assert summary["steps"] == {"net.move": {"count": 2, "wall_s": 0.75, "simulated_s": 4.0}}


def test_times_of_a_command_begin_with_it() -> None:
    times = StepTimes()
    times.note_start("net.move", 0, 1.0)
    times.note_end("net.move", 0, 2.0, 0.5)
    times.restart(7)
    times.add_times(None)
    assert times.to_dict() == {}


def test_times_of_a_command_are_not_those_of_one_beside_it() -> None:
    times = StepTimes()
    times.note_start("net.begin", 7, 0.5)  # told before its first function has run
    times.restart(7)
    times.note_start("net.move", 7, 1.0)
    times.note_start("net.move", 8, 2.0)
    times.note_end("net.move", 7, 4.0, 0.5)
    times.note_end("net.move", 8, 9.0, 0.25)
    times.note_end("net.begin", 7, 2.5, 0.125)
    assert times.to_dict() == {"net.move": [1, 0.5, 3.0], "net.begin": [1, 0.125, 2.0]}
    for number in range(3 * MOST_STARTED):
        times.note_start("net.move", 100 + number, 1.0)
    assert len(times._started) == MOST_STARTED


def test_skipped_poses_stand_behind_those_that_the_solver_rejected() -> None:
    told = {"pose": "p3", "camera": "", "reason": "out of reach"}
    report = succeeded({"success": True, "points_rejected": [{"pose": "p7"}]}, [told], 20)
    assert report == {"success": True, "points_rejected": [{"pose": "p7"}, told], "poses": 20}
    assert failed("stopped", [told])["points_rejected"] == [told]
