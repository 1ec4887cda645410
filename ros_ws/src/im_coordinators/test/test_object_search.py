"""An object is found among the points of a sweep by height and size, or a sentence says why not."""

import numpy as np
import pytest

from im_cell.laser_model import LaserModel
from im_cell.robot import FreeBody, load_cell
from im_coordinators.object_search import height_of, middle_of, sweep_over
from im_core.errors import ImError

CELL = load_cell()
REGION = [-0.5, 0.82, 0.5, 1.2]
BOTTLE = FreeBody(
    name="bottle", kind="cylinder", size=(0.05, 0.05, 0.22), mass=0.3, color=(0, 0, 0), position=(0, 1, 0.86)
)


def face(x, y, height, random, radius=0.025):
    """Points of lines 15 mm apart on a round face, along each line as far apart as pixels of a camera are."""
    lines, steps = np.meshgrid(np.arange(-0.1, 0.1, 0.015) + random.uniform(0, 0.015), np.arange(-0.1, 0.1, 0.0057))
    across = np.column_stack((lines.ravel(), steps.ravel()))
    across = across[np.linalg.norm(across, axis=1) < radius]
    heights = height + random.normal(0.0, 0.0015, len(across))
    return np.column_stack((across + np.array([x, y]), heights))


@pytest.mark.parametrize("seed", range(10))
def test_the_middle_is_found_among_the_faces_of_others(seed):
    random = np.random.default_rng(seed)
    x, y = random.uniform([-0.45, 0.87], [0.1, 1.15])
    ground = height_of(CELL, "table")
    table = np.column_stack((random.uniform(REGION[:2], REGION[2:], (500, 2)), np.full(500, ground)))
    wider, lower = face(x + 0.25, y, 0.97, random, radius=0.06), face(x + 0.12, y, 0.95, random)
    points = np.vstack((table, wider, lower, face(x, y, 0.97, random)))
    assert middle_of(points, BOTTLE, ground, REGION) == pytest.approx([x, y, 0.86], abs=9e-3)


def test_nothing_and_two_of_a_size_are_sentences():
    random, ground = np.random.default_rng(1), 0.75
    one, other = face(-0.2, 1.0, 0.97, random), face(0.2, 1.0, 0.97, random)
    for points, why in ((one - [0, 0, 0.02], "nothing stands"), (np.vstack((one, other)), "2 objects stand")):
        with pytest.raises(ImError, match=rf"'bottle' was not found: of its size, 220 mm high, {why}") as raised:
            middle_of(points, BOTTLE, ground, REGION)
        assert raised.value.code == "not_found"
    with pytest.raises(ImError, match="there is no obstacle 'shelf'"):
        height_of(CELL, "shelf")


def test_a_sweep_covers_its_region_within_the_range_of_the_mirrors():
    sweep = sweep_over(CELL, REGION, 0.97)
    angles = LaserModel(*CELL.laser.pose(), CELL.laser.gap).angles_to(
        [[x, y, 0.97] for x in (-0.5, 0.5) for y in (0.82, 1.2)]
    )
    for mirror, (low, high) in enumerate((sweep["span"], sweep["sweep"])):
        assert -CELL.laser.range <= low < angles[:, mirror].min()
        assert angles[:, mirror].max() < high <= CELL.laser.range
    for region, why in (([0.5, 0.8, -0.5, 1.2], "smaller corner"), ([7.0, 7.0, 8.0, 8.0], "out of the laser's reach")):
        with pytest.raises(ImError, match=why):
            sweep_over(CELL, region, 0.97)
