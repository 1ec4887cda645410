"""Strategies of the coordinators without ROS."""

import itertools

import pytest

from im_coordinators.strategies import another_look_may_help, detour


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        (["too faint: snr 3.1 < 6"], True),
        (["too faint: snr 3.1 < 6", "3 candidates of equal rank"], True),
        (["blocked: nothing brighter than the noise"], False),
        (["too faint: snr 3.1 < 6", "light is off"], False),
        ([], False),
    ],
)
def test_only_what_exposure_can_mend_is_looked_at_again(causes: list[str], expected: bool) -> None:
    assert another_look_may_help(causes) is expected


def test_a_detour_moves_the_cart_only_while_the_arm_is_tucked() -> None:
    start, goal, tucked = [0.0, 1.0, 2.0, 3.0], [4.0, 5.0, 6.0, 7.0], [9.0, 9.0, 8.0, 8.5]
    points = [start, *detour(start, goal, tucked, arm=2)]
    assert points[-1] == goal
    for before, after in itertools.pairwise(points):
        if before[:2] != after[:2]:
            assert before[2:] == after[2:] == tucked[2:]
