"""The place of an object follows from the print on its upper face, or a sentence says why there is none."""

import math

import numpy as np
import pytest

from im_cell.robot import Cell, FreeBody
from im_cell.rotations import matrix_of_rpy, matrix_of_vector
from im_coordinators.object_search import middle_covariance, printed_body, standing_place
from im_core.errors import ImError


def body(name="part", size=(0.05, 0.05, 0.22), fiducial=3):
    return FreeBody(
        name=name, kind="box", size=size, mass=0.3, color=(0, 0, 0), position=(0, 1, 0.86), fiducial=fiducial
    )


@pytest.mark.parametrize("turn", [-3.0, -0.7, 0.1, 1.5, 2.9])
@pytest.mark.parametrize(("size", "same"), [((0.05, 0.05, 0.2), math.pi / 2), ((0.05, 0.07, 0.2), math.pi)])
def test_a_body_put_back_by_its_print_looks_the_same(turn, size, same):
    rotation = matrix_of_rpy((0.02, -0.03, turn))
    middle = np.array([0.3, 1.1, 0.85])
    x, y, z, found = standing_place(body(size=size), rotation, middle + rotation @ [0.0, 0.0, 0.1])
    assert (x, y, z) == pytest.approx(tuple(middle))
    assert abs(found) <= same / 2 + 1e-9
    assert math.remainder(found - turn, same) == pytest.approx(0.0, abs=0.01)


def test_bodies_that_lean_are_unknown_or_have_no_print_are_sentences():
    with pytest.raises(ImError, match="'part' leans by 20 degrees"):
        standing_place(body(), matrix_of_rpy((math.radians(20.0), 0.0, 0.0)), np.zeros(3))
    cell = Cell.model_construct(objects=(body(), body("plain", fiducial=None)))
    assert printed_body(cell, "part") == (cell.objects[0], 3)
    with pytest.raises(ImError, match="there is no object 'cup'"):
        printed_body(cell, "cup")
    with pytest.raises(ImError, match="'plain' has no fiducial by which it can be found; there are: part"):
        printed_body(cell, "plain")


def test_the_middle_is_as_uncertain_as_prints_drawn_about_the_true_one_say():
    rotation, rng = matrix_of_rpy((3.0, 0.3, 0.4)), np.random.default_rng(2)
    root = np.diag([1e-4, 1e-4, 1e-3, 5e-3, 5e-3, 1e-3]) @ rng.normal(size=(6, 6))
    drawn = rng.normal(size=(20_000, 6)) @ root.T
    middles = np.array([one[:3] - 0.11 * (matrix_of_vector(one[3:]) @ rotation)[:, 2] for one in drawn])
    assert middle_covariance(body(), rotation, root @ root.T) == pytest.approx(np.cov(middles.T), rel=0.1, abs=3e-8)
