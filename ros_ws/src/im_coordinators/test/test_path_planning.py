"""What the Path Planning Coordinator tries."""

import pytest

from im_cell.robot import Group
from im_coordinators.path_planning import (
    another_may_help,
    configuration,
    home_seed,
    neighbours,
    require_joints,
    search_may_help,
    tucked_seed,
)
from im_core.errors import DataError, ImError

CARRIERS = 3
START, TUCKED = [0.0, 1.0, 2.0, 3.0, 3.5], [9.0, 9.0, 9.0, 8.0, 8.5]


def test_another_configuration_is_sought_with_the_cart_where_it_is() -> None:
    assert tucked_seed(START, TUCKED, CARRIERS) == [0.0, 1.0, 2.0, 8.0, 8.5]


def test_only_what_is_in_the_way_can_be_circumvented_and_only_once_by_another_configuration() -> None:
    blocked, unreachable = ImError("", code="collision"), ImError("", code="unreachable")
    assert [search_may_help(failure) for failure in (blocked, unreachable, None)] == [True, False, False]
    assert another_may_help(blocked, {})
    assert not another_may_help(blocked, {"another": True})


def test_a_configuration_has_a_position_for_each_joint() -> None:
    assert configuration([1, 2.5], ["a", "b"], "left") == [1.0, 2.5]
    with pytest.raises(DataError, match="argument joints has 1 positions; left has 2 joints: a, b"):
        configuration([1], ["a", "b"], "left")


def test_a_given_path_is_for_the_joints_of_its_group() -> None:
    require_joints(["a", "b"], ["a", "b"], "left")
    for wrong, told in ((["b", "a"], "b, a"), ([], "joints without names")):
        with pytest.raises(DataError, match=f"the given path is for {told}; left has the joints a, b"):
            require_joints(wrong, ["a", "b"], "left")


def test_a_configuration_near_home_is_sought_from_where_an_arm_is_that_is_there() -> None:
    home = [0.5, -0.5]
    assert home_seed([0.501, -0.5], home) == [0.501, -0.5]
    assert home_seed([0.5, -0.4], home) == home


def test_neighbours_are_the_other_groups_of_the_partition_in_force() -> None:
    each = {"left": Group(joints=("a", "b")), "right": Group(joints=("c", "d"))}
    arms = {"left": Group(joints=("b",)), "right": Group(joints=("d",)), "carts": Group(joints=("a", "c"))}
    partitions = {"each": each, "arms": arms, "all": {"all": Group(joints=("a", "b", "c", "d"))}}
    assert neighbours(partitions, "left", ["a", "b"]) == ("right",)
    assert neighbours(partitions, "left", ["b"]) == ("right", "carts")
    assert neighbours(partitions, "all", ["a", "b", "c", "d"]) == ()
