"""Observations of the light on a wrist, from messages to a problem: the derivatives by the errors of the arm."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from im_calibration import Observation, SeenPoints, problem_of, views_of
from im_calibration.problem.observations import observation_of
from im_calibration.targets.target import target_of
from im_core.errors import DataError, ImError

JACOBIANS = np.arange(24, dtype=float).reshape(2, 3, 4) * 1e-5


def observation(number, jacobian):
    wrist = SimpleNamespace(
        position=SimpleNamespace(x=0.1 * number, y=0.0, z=1.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    covariance = (1e-10 * np.eye(3)).ravel()
    return observation_of(
        SimpleNamespace(
            pose=f"p{number}", wrist=wrist, position_covariance=covariance, spots=[], arm_jacobian=list(jacobian)
        )
    )


def problem(*observations):
    return problem_of(("eye",), observations, (), {"eye": (640, 480)}, ((0.0, 0.0, 0.1), 0.01), {"eye"}, None)


def test_derivatives_by_the_errors_of_the_arm_come_into_the_problem():
    found = problem(*(observation(number, each.ravel()) for number, each in enumerate(JACOBIANS)))
    np.testing.assert_array_equal(found.arm_jacobians, JACOBIANS)
    assert problem(*(observation(number, ()) for number in range(2))).arm_jacobians is None


def test_derivatives_without_three_rows_or_of_different_arms_are_refused():
    with pytest.raises(DataError, match="arm_jacobian of pose 'p1' has 4 numbers, three rows are needed"):
        observation(1, np.zeros(4))
    with pytest.raises(DataError, match=r"the observations have arm_jacobian of \[0, 4\] columns"):
        problem(observation(0, JACOBIANS[0].ravel()), observation(1, ()))


def seen_board(**changes):
    points = chessboard().points
    views = {"wall": SeenPoints(points[:, :2] * 1e3 + 100.0, np.full(len(points), 0.1), 5)}
    return replace(Observation("p1", np.zeros(3), np.eye(3), np.zeros((3, 3)), {}, np.zeros((6, 2)), views), **changes)


def chessboard():
    return target_of("chessboard:6x5:55mm")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"position": np.array([0.0, np.nan, 0.0])}, "pose 'p1' holds a value that is not finite"),
        ({"wrist_covariance": np.full((6, 6), np.inf)}, "pose 'p1' holds a value that is not finite"),
        ({"views": {"wal": SeenPoints(np.zeros((30, 2)), np.ones(30), 5)}}, "there is no camera 'wal'"),
        (
            {"views": {"wall": SeenPoints(np.zeros((29, 2)), np.ones(29), 5)}},
            "wall has 29 points, the target .* has 30",
        ),
        ({"arm_jacobian": np.zeros((6, 3))}, "arm_jacobian of shapes"),
    ],
)
def test_views_of_a_board_that_cannot_be_are_refused(changes, told):
    sizes = {"wall": (640, 480)}
    views = views_of(("wall",), [seen_board()] * 2, chessboard(), sizes, ["wall"])
    assert views.robot.arm.shape == (2, 6, 2)
    with pytest.raises(ImError, match=told):
        views_of(("wall",), [seen_board(), seen_board(**changes)], chessboard(), sizes, ["wall"])
