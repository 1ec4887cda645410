"""What the Motion Coordinator decides."""

import pytest

from im_coordinators.motion import carrier_of, group_held, require_rest
from im_core.errors import StateError


@pytest.mark.parametrize(
    ("reserved", "group"), [([], "left"), (["right"], "right"), (["right", "left"], "left"), (["testbed"], "testbed")]
)
def test_the_left_arm_moves_unless_only_others_are_held(reserved: list[str], group: str) -> None:
    assert group_held(reserved) == group


def test_a_light_is_carried_by_the_arm_of_its_name() -> None:
    assert carrier_of("right_led") == "right"


def test_a_position_measured_in_motion_is_refused() -> None:
    require_rest("left", True)
    with pytest.raises(StateError, match="left is not at rest"):
        require_rest("left", False)
