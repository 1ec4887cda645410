"""Observations of the light on a wrist, from messages to a problem: the derivatives by the errors of the arm."""

from types import SimpleNamespace

import numpy as np
import pytest

from im_calibration import problem_of
from im_calibration.problem.observations import observation_of
from im_core.errors import DataError

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
    return problem_of(("eye",), observations, (), {"eye": (640, 480)}, ((0.0, 0.0, 0.1), 0.01), {"eye"})


def test_derivatives_by_the_errors_of_the_arm_come_into_the_problem():
    found = problem(*(observation(number, each.ravel()) for number, each in enumerate(JACOBIANS)))
    np.testing.assert_array_equal(found.arm_jacobians, JACOBIANS)
    assert problem(*(observation(number, ()) for number in range(2))).arm_jacobians is None


def test_derivatives_without_three_rows_or_of_different_arms_are_refused():
    with pytest.raises(DataError, match="arm_jacobian of pose 'p1' has 4 numbers, three rows are needed"):
        observation(1, np.zeros(4))
    with pytest.raises(DataError, match=r"the observations have arm_jacobian of \[0, 4\] columns"):
        problem(observation(0, JACOBIANS[0].ravel()), observation(1, ()))
