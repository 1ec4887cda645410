"""Cost against size: what a row is compared with, and the poses of a long command."""

import pytest

from bench.sizes.commands import poses_file
from bench.sizes.growth import growth
from im_dispatcher.poses_file import load_poses


def test_a_cost_is_compared_with_the_smallest_in_proportion_or_as_it_is():
    costs = {100: 30.0, 10: 2.0}
    least, most = growth("calibration", costs, "s", "poses")
    assert (least.name, least.baseline) == ("calibration, 10 poses", None)
    assert (most.baseline, most.measure, most.against) == (20.0, 1.5, "10 poses, in proportion")
    (_, most) = growth("firing", costs, "us", "places", linear=False)
    assert (most.measure, most.against) == (15.0, "10 places")


def test_none_and_one_can_be_sizes_too():
    none, one = growth("firing", {0: 2.0, 1: 3.0}, "us", "subscribers", linear=False)
    assert (none.name, one.name, one.measure) == ("firing, 0 subscribers", "firing, 1 subscriber", 1.5)


@pytest.mark.parametrize("count", [10, 100])
def test_a_long_command_has_the_poses_of_the_cell_again_and_again(tmp_path, count):
    poses = load_poses(poses_file(count, tmp_path)).poses
    assert len({pose.name for pose in poses}) == count
    assert poses[-1].position_m == load_poses(poses_file(200, tmp_path)).poses[(count - 1) % 40].position_m
