"""Jaws that press with limited force, alone and on something."""

import numpy as np
import pytest

from im_cell.link import JawObject
from im_cell.robot import load_cell
from im_core.errors import DataError
from im_sim.grippers import GripperJaws

GRIPPER = load_cell().gripper
DT = 0.0045
WIDTH, STIFFNESS = 0.03, 1.0e4


@pytest.fixture
def grippers():
    return GripperJaws(GRIPPER, 2)


def run(grippers, ticks, opening, force=(np.inf, np.inf)):
    for _ in range(ticks):
        grippers.command(np.array(opening), np.array(force))
        grippers.step(DT)


def test_empty_jaws_go_where_they_are_told_and_press_on_nothing(grippers):
    run(grippers, 100, [0.0, np.nan])
    assert grippers.opening.tolist() == [0.0, GRIPPER.initial]
    assert grippers.force.tolist() == [0.0, 0.0]
    assert grippers.held() == (None, None)


@pytest.mark.parametrize("force", [5.0, 60.0, np.inf])
def test_jaws_stop_at_an_object_with_the_force_allowed(grippers, force):
    grippers.put((JawObject(WIDTH, STIFFNESS, 0.1), None))
    openings = []
    for _ in range(100):
        run(grippers, 1, [0.0, 0.0], [force, force])
        openings.append(grippers.opening[0])
    allowed = min(force, GRIPPER.force)
    assert grippers.force[0] == pytest.approx(allowed)
    assert grippers.opening[0] == pytest.approx(WIDTH - allowed / STIFFNESS)
    assert openings[-1] == openings[-2], "they stand, although they were told to close: stalled"
    assert grippers.opening[1] == 0.0
    assert grippers.held()[0].mass == 0.1
    assert np.abs(np.diff(openings)).max() <= GRIPPER.rate * DT + 1e-12


def test_less_force_lets_the_object_push_and_opening_lets_it_go(grippers):
    grippers.put((JawObject(WIDTH, STIFFNESS, 0.1), None))
    run(grippers, 100, [0.0, 0.0])
    run(grippers, 5, [0.0, 0.0], [10.0, 10.0])
    assert grippers.force[0] == pytest.approx(10.0)
    assert grippers.opening[0] == pytest.approx(WIDTH - 10.0 / STIFFNESS)
    run(grippers, 100, [0.05, 0.0])
    assert grippers.opening[0] == pytest.approx(0.05)
    assert grippers.held() == (None, None)
    run(grippers, 100, [0.0, 0.0])
    grippers.put((None, None))
    run(grippers, 100, [0.0, 0.0])
    assert grippers.opening[0] == 0.0
    assert grippers.force[0] == 0.0


def test_an_opening_within_the_object_presses_less_than_allowed(grippers):
    grippers.put((None, JawObject(WIDTH, STIFFNESS, 0.1)))
    run(grippers, 100, [0.0, WIDTH - 0.001])
    assert grippers.force[1] == pytest.approx(0.001 * STIFFNESS)


@pytest.mark.parametrize("values", [(0.0, 1.0, 1.0), (0.01, -1.0, 0.0), (0.01, 1.0, -0.1), (np.nan, 1.0, 1.0)])
def test_objects_that_cannot_be_are_refused(values):
    with pytest.raises(DataError, match="cannot be: width and stiffness are > 0"):
        JawObject(*values)
