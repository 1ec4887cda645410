"""The loop of calibrate_camera, and what a command may ask for, without ROS."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import ConfigError, DataError, NotFoundError, StateError
from im_dispatcher.commands.calibrate_camera import COMMAND, SYMBOL
from im_dispatcher.job import FEWEST_POSES, PoseLoop, order_of
from im_pnt.netfile import load_net

DECLARED = load_net(COMMAND.net).commands[SYMBOL].arguments
CEILING = ("ceiling_left", "ceiling_right")
KNOWN = (*CEILING, "wall")


def returned(loop: PoseLoop) -> PoseLoop:
    """The loop after its dispatcher died and came back."""
    return PoseLoop.from_json(json.loads(json.dumps(loop.to_json())))


@given(st.lists(st.booleans(), min_size=FEWEST_POSES, max_size=40), st.lists(st.integers(0, 39)))
def test_every_pose_is_either_observed_or_skipped_whenever_the_dispatcher_dies(
    outcomes: list[bool], deaths: list[int]
) -> None:
    loop = PoseLoop(len(outcomes))
    for number, seen in enumerate(outcomes):
        assert loop.more_poses()
        assert loop.next_pose() == number + 1
        if number in deaths:
            loop = returned(loop)
        if not seen:
            assert loop.skip() == outcomes[: number + 1].count(False)
    assert not loop.more_poses()
    assert loop.progress == 1.0
    assert loop.taken - loop.skipped == outcomes.count(True)
    with pytest.raises(DataError, match="all poses have been visited"):
        loop.next_pose()


@given(st.integers(1, 1000), st.data())
def test_a_loop_comes_back_as_it_was_and_takes_no_more_room_than_before(poses: int, data: st.DataObject) -> None:
    taken = data.draw(st.integers(0, poses))
    loop = PoseLoop(poses, taken, data.draw(st.integers(0, taken)))
    assert returned(loop) == loop
    assert len(json.dumps(loop.to_json())) < 30


@given(st.lists(st.sampled_from(["kept", "faint", "gone"]), min_size=FEWEST_POSES, max_size=60), st.data())
def test_what_is_visited_again_is_visited_and_nothing_else_is_twice(fates: list[str], data: st.DataObject) -> None:
    """The arm goes on while a pose is looked at; what becomes of that is known before the next look."""
    loop, kept = PoseLoop(FEWEST_POSES), []
    loop.next_pose()
    for fate in fates:
        visit = loop.look()
        if loop.more_poses():
            loop.next_pose()
        if data.draw(st.booleans()):
            loop = returned(loop)
        if fate == "kept" or (fate == "faint" and visit.longer):
            kept.append(visit.number)
        else:
            loop.give_back_looked(longer=fate == "faint")
            loop.give_back_looked(longer=fate == "faint")  # whatever died may do it twice
        if loop.present == loop.looked:  # the last one: the arm has stayed
            if not loop.more_poses():
                break
            loop.next_pose()
    assert len(kept) == len(set(kept))
    left = {visit.number for visit in loop.again} | set(range(loop.taken + 1, FEWEST_POSES + 1))
    assert set(kept) | left | {loop.present.number} == set(range(1, FEWEST_POSES + 1))


@pytest.mark.parametrize("memory", [None, {}, [1, 2], ["1", 2, 3], [1, 2, 3], [1, 2, 3, [], []]])
def test_without_a_command_there_is_no_loop(memory: object) -> None:
    with pytest.raises(StateError, match="no calibrate_camera command is running"):
        PoseLoop.from_json(memory)


def test_a_loop_that_is_none_is_told() -> None:
    with pytest.raises(StateError, match=r"\[1\] is no pose of a loop"):
        PoseLoop.from_json([40, 2, 0, [[1]], [], []])


def test_a_pose_is_dispensable_only_while_enough_remain() -> None:
    loop = PoseLoop(FEWEST_POSES + 1)
    with pytest.raises(DataError, match="no pose has been taken yet"):
        loop.skip()
    loop.next_pose()
    assert loop.dispensable("spot_not_found")
    assert loop.dispensable("unusable")
    assert not loop.dispensable("state")
    loop.skip()
    loop.next_pose()
    assert not loop.dispensable("spot_not_found")


def test_a_command_without_arguments_calibrates_the_ceiling_with_the_cells_own_poses() -> None:
    for arguments in ({}, {"cameras": [], "poses_file": ""}):
        order = order_of(DECLARED.check(arguments, "it"), KNOWN)
        assert (order.cameras, order.light, len(order.file.poses)) == (CEILING, "left_led", 40)


def test_wrong_cameras_and_too_few_poses_are_named(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="no camera 'ceiling_lefd'; did you mean 'ceiling_left'"):
        order_of({"cameras": ["ceiling_lefd"], "poses_file": "", "group": "left"}, KNOWN)
    with pytest.raises(DataError, match="'wall' is named twice"):
        order_of({"cameras": ["wall", "wall"], "poses_file": "", "group": "left"}, KNOWN)
    few = tmp_path / "few.yaml"
    pose = "  - {{name: p{}, position_m: [0, 0, 1], orientation_xyzw: [0, 0, 0, 1]}}\n"
    few.write_text("group: left\nframe: world\nposes:\n" + "".join(pose.format(number) for number in range(5)))
    with pytest.raises(DataError, match=f"5 poses are too few .* at least {FEWEST_POSES}"):
        order_of({"cameras": [], "poses_file": str(few), "group": "left"}, KNOWN)
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read"):
        order_of({"cameras": [], "poses_file": str(tmp_path / "nowhere.yaml"), "group": "left"}, KNOWN)
