"""Poses files: what is accepted, and how faults are told."""

from pathlib import Path

import numpy as np
import pytest

from im_cell.robot import load_cell
from im_core.errors import ConfigError, DataError, StateError
from im_dispatcher.poses_file import PosesFile, WristPose, load_named_poses, load_poses

HEAD = "group: left\nframe: world\nposes:\n"
POSE = "  - {{name: {name}, position_m: [0.1, 0.2, 1.0], orientation_xyzw: [0, 0, 0, 1]}}\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "poses.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_cells_own_poses_are_forty() -> None:
    assert len(load_named_poses("").poses) == 40


def test_the_poses_that_a_cell_names_for_a_camera_on_an_arm_are_of_the_arm_that_shows_the_light() -> None:
    checks = [camera.check for camera in load_cell().cameras.values() if camera.check]
    assert [load_named_poses(check.poses).group for check in checks] == [check.arm for check in checks] == ["right"]


def test_the_cells_own_poses_need_the_other_arm_at_home() -> None:
    file = load_named_poses("")
    joints, home = [f"right_{number}" for number in range(9)], list(load_cell().groups["right"].home)
    file.require_other(joints, home)
    home[3] += 0.3
    with pytest.raises(StateError, match=r"right_3 is at 0\.300, not 0\.000; .* im run home --group right") as told:
        file.require_other(joints, home)
    assert told.value.facts == {"joint": "right_3", "value": 0.3, "allowed": 0.0}
    with pytest.raises(DataError, match="other_joints of the poses has 9 positions, the right arm has 3 joints"):
        file.require_other(joints[:3], home[:3])


def test_poses_are_read_in_order(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + POSE.format(name="a") + POSE.format(name="b"))
    assert [pose.name for pose in load_poses(path).poses] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"poses\.yaml:1: the file is empty"),
        ("[1, 2", r"poses\.yaml:1: not YAML"),
        (
            HEAD + "  - {name: a, position_m: [0, 0], orientation_xyzw: [0, 0, 0, 1]}\n",
            r"yaml:4: poses\[0\].position_m",
        ),
        (
            HEAD + POSE.format(name="a") + "  - {name: b, position_m: [0, .nan, 0], orientation_xyzw: [0, 0, 0, 1]}\n",
            r"yaml:5: poses\[1\].position_m\[1\]",
        ),
        (
            HEAD + "  - {name: a, position_m: [0, 0, 1], orientation_xyzw: [0, 0, 0, 2]}\n",
            "length 2.0000; it must be 1",
        ),
        (
            HEAD + "  - {name: a, position_m: [0, -100.5, 1], orientation_xyzw: [0, 0, 0, 1]}\n",
            r"yaml:4: poses\[0\].position_m\[1\]: -100.5: Input should be greater than or equal to -100",
        ),
        (
            HEAD + '  - {name: "a\\a", position_m: [0, 0, 1], orientation_xyzw: [0, 0, 0, 1]}\n',
            r"yaml:4: poses\[0\].name: .*control character U\+0007 is not allowed in a text",
        ),
        (HEAD + "".join(POSE.format(name=f"p{n}") for n in range(1001)), "at most 1000 items"),
        (HEAD + POSE.format(name="a") * 2, "two poses are named 'a'"),
        (
            "order: free\n" + HEAD + POSE.format(name="a"),
            "order: free needs the joints of each pose; pose 'a' has none",
        ),
        ("group: middle\nframe: world\nposes: []\n", r"yaml:1: group"),
    ],
)
def test_faults_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_poses(written(tmp_path, text))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read"):
        load_poses(tmp_path / "nowhere.yaml")


def test_poses_that_are_read_again_and_again_stay_the_same() -> None:
    """They are stored with the command, and a mission that is run again reads them once more or less often."""
    own = load_named_poses("")
    rng = np.random.default_rng(4)
    drawn = [
        WristPose(name=str(number), position_m=(0.0, 0.0, 1.0), orientation_xyzw=tuple(each / np.linalg.norm(each)))
        for number, each in enumerate(rng.normal(size=(500, 4)) * [1.0, 1.0, 1.0, 1e-3])
    ]
    rounded = [
        each.model_copy(update={"orientation_xyzw": tuple(np.round(each.orientation_xyzw, 4))}) for each in drawn
    ]
    for poses in (own.poses, drawn, [WristPose(**each.model_dump()) for each in rounded]):
        file = own.model_copy(update={"poses": tuple(poses), "order": "given"})
        again = PosesFile.model_validate_json(file.model_dump_json())
        assert again == file
        assert PosesFile.model_validate_json(again.model_dump_json()) == file
