"""What the Motion Coordinator decides."""

from dataclasses import dataclass

import pytest

from im_coordinators.motion import (
    DESTINATIONS,
    check_told,
    depends_on_here,
    planned_beforehand,
    require_rest,
    require_working,
    state_for,
    take_path,
    way_asked,
)
from im_core.errors import DataError, StateError

NOTHING = {"destination": "", "position": [], "joints": [], "path": ""}


@pytest.mark.parametrize(
    "asked", [{"destination": "goal"}, {"position": [0, 0, 0]}, {"joints": [0.0]}, {"path": "given"}]
)
def test_a_move_is_asked_for_in_one_way(asked: dict[str, object]) -> None:
    assert [way_asked({**NOTHING, **asked}, tuple(NOTHING), "move_robot")] == list(asked)


@pytest.mark.parametrize(
    ("asked", "told"), [({}, "none"), ({"destination": "goal", "joints": [0.0]}, "destination and joints")]
)
def test_a_move_that_is_asked_for_in_no_way_or_in_several_is_refused(asked: dict[str, object], told: str) -> None:
    text = f"plan_path needs one of the arguments destination, position, joints, posture; it was given {told}"
    with pytest.raises(DataError, match=text):
        way_asked({**NOTHING, **asked}, DESTINATIONS, "plan_path")


def test_a_path_that_was_planned_beforehand_is_taken_once() -> None:
    """A move in doubt comes back to the choice: its path no longer begins where the arm is."""
    memory: dict[str, object] = {}
    assert not planned_beforehand({"planned": False}, memory)
    assert planned_beforehand({"planned": True}, memory)
    take_path(memory)
    assert not planned_beforehand({"planned": True}, memory)


@pytest.mark.parametrize(
    ("asked", "depends"),
    [
        ({"joints": [0.0]}, False),
        ({"destination": "goal"}, False),
        ({"position": [0, 0, 1], "orientation": [0, 0, 0]}, False),
        ({"position": [0, 0, 1]}, True),  # as the tool is turned now
        ({"position": [0, 0, 1], "orientation": [0, 0, 0], "frame": "tool"}, True),
    ],
)
def test_some_moves_lead_to_where_depends_on_where_the_tool_is(asked: dict[str, object], depends: bool) -> None:
    assert depends_on_here({**NOTHING, "orientation": [], "frame": "world", **asked}) is depends


def test_a_position_measured_in_motion_is_refused() -> None:
    require_rest("left", True)
    with pytest.raises(StateError, match="left is not at rest"):
        require_rest("left", False)
    with pytest.raises(StateError, match=r"of no use \(MCS: emergency stop by hand\)$"):
        require_rest("left", False, "emergency stop by hand")


@dataclass
class Told:
    group: str
    state: str
    reserved: bool = True
    owner: str = ""


def test_an_arm_is_in_a_state_for_him_alone_who_may_move_it() -> None:
    groups = [Told("left", "motion", owner="/me"), Told("right", "active", owner="/you"), Told("third", "reserved")]
    assert [state_for(groups, group, "/me") for group in ("left", "right", "third")] == ["motion", "cold", "reserved"]
    assert [state_for(groups, group, "/you") for group in ("left", "right", "third")] == ["cold", "active", "reserved"]
    assert state_for([Told("left", "cold", reserved=False)], "left", "/me") == "cold"
    assert state_for([], "left", "/me") == "cold"


def test_what_can_be_no_state_of_mcs_was_not_said_by_it() -> None:
    check_told("unconfigured", [])
    check_told("motion", [Told("left", "motion"), Told("right", "cold", reserved=False)])
    with pytest.raises(DataError, match="MCS cannot be '77'; its states are active, cold, "):
        check_told("77", [])
    with pytest.raises(DataError, match=r"group 'left' cannot be ''; its states are"):
        check_told("motion", [Told("left", "")])
    with pytest.raises(DataError, match=r"^MCS cannot be 'x{40}'; [^x]*$"):
        check_told("x" * 10**6, [])


def test_nothing_is_asked_to_move_where_mcs_has_stopped_and_its_reason_is_told() -> None:
    for state in ("cold", "reserved", "active", "motion"):
        require_working(state, "", "left_gripper")
    with pytest.raises(StateError, match="left_gripper does not move, for MCS is unconfigured: the servo ended"):
        require_working("unconfigured", "the servo ended", "left_gripper")
    with pytest.raises(StateError, match=r"left_gripper does not move, for MCS is estopped$"):
        require_working("estopped", "", "left_gripper")
