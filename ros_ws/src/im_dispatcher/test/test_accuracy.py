"""A calibration to a stated accuracy: which visits are chosen, when they end, and what is said where they cannot."""

import numpy as np
import pytest

from bench.calibration.asked_accuracy import CAMERAS, asked_accuracy, seconds_of, seen
from im_calibration import calibrate
from im_cell.camera_model import nominal
from im_cell.robot import load_cell
from im_core.errors import DataError
from im_dispatcher.accuracy import FIRST_POSES, LOOKS, accuracy_reached, next_visits
from im_dispatcher.job import order_of, problem_of_light
from im_dispatcher.poses_file import load_named_poses

OWN = load_named_poses("")
#: Estimated time of all shipped poses in their order, one look at each [s].
ALL_S = seconds_of(OWN, range(1, len(OWN.poses) + 1), len(OWN.poses))


@pytest.mark.parametrize(("seed", "accuracy_m"), [(0, 1.83e-4), (2, 3e-4)])
def test_the_accuracy_is_reached_in_about_half_of_the_time_of_all_poses_and_is_true(
    seed: int, accuracy_m: float
) -> None:
    reached = asked_accuracy(seed, accuracy_m)
    assert reached.expected_mm <= 1e3 * accuracy_m
    assert reached.true_mm < 1.5 * reached.expected_mm
    assert reached.seconds < 0.55 * ALL_S
    assert reached.looks == LOOKS * reached.poses


def test_the_own_poses_of_the_cell_leave_no_rim_of_the_images_unknown() -> None:
    cell, rng = load_cell(), np.random.default_rng(0)
    cameras, offset = [nominal(cell.cameras[name]) for name in CAMERAS], np.array(cell.led.offset)
    observed = [seen(rng, OWN, number, 0, cameras, offset) for number in range(1, len(OWN.poses) + 1)]
    calibration = calibrate(problem_of_light(CAMERAS, observed))
    assert calibration.success
    assert [image.told for image in calibration.images] == ["", ""]


def test_the_first_visits_are_as_many_as_a_calibration_needs_and_no_pose_comes_twice() -> None:
    visits = next_visits(OWN, CAMERAS, 1e-3, {}, (), ()).poses
    assert len(set(visits)) == FIRST_POSES
    assert all(visits.count(pose) == LOOKS for pose in visits)
    barred = visits[0]
    assert barred not in next_visits(OWN, CAMERAS, 1e-3, {}, (), (barred,)).poses


def test_visits_end_where_no_pose_is_left() -> None:
    assert next_visits(OWN, CAMERAS, 1e-3, {}, (), range(1, 41)).poses == ()


def test_what_is_expected_is_compared_with_what_was_asked() -> None:
    solver = {"success": True, "expected_error": {"triangulation_mm": 0.25}}
    assert accuracy_reached(solver, 3e-4, [1, 1, 2]) == {
        "asked_mm": pytest.approx(0.3), "expected_mm": 0.25, "reached": True, "poses": 2, "looks": 3,
    }  # fmt: skip
    told = accuracy_reached(solver, 2e-4, [1])
    assert told["message"] == "an error of 0.250 mm is expected, 0.2 mm was asked for: the poses have run out"
    unknown = {"success": False, "expected_error": {"triangulation_mm": None}}
    assert str(accuracy_reached(unknown, 2e-4, [1])["message"]).startswith("no error is known, 0.2 mm was asked for")


@pytest.mark.parametrize(
    ("cameras", "order", "refusal"),
    [
        ([], "given", "an accuracy needs poses in free order; the poses file says order: given"),
        (["ceiling_left"], "free", "needs two cameras or more, all fixed to the world; 1 of ceiling_left are fixed"),
        (["wall", "wrist_left"], "free", "1 of wall, wrist_left are fixed"),
    ],
)
def test_an_accuracy_that_cannot_be_had_is_refused(cameras: list[str], order: str, refusal: str) -> None:
    file = OWN.model_copy(update={"order": order})
    arguments = {"cameras": cameras, "poses_file": "", "group": "left", "accuracy": 3e-4}
    with pytest.raises(DataError, match=refusal):
        order_of(arguments, list(load_cell().cameras), lambda _: file)
    assert order_of({**arguments, "accuracy": 0.0}, list(load_cell().cameras), lambda _: file).accuracy_m == 0.0
