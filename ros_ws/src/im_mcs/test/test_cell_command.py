"""``im cell``: a first cell file of a URDF, and what a cell file leaves open."""

import re
import shutil
import struct

import numpy as np
import pytest

from im_cell.robot import cell_file, load_cell
from im_core.errors import ConfigError, DataError
from im_mcs.cell.capsules import enclose
from im_mcs.cell.command import main
from im_mcs.cell.template import first_cell
from im_mcs.limits.configuration import load_config


def test_capsules_hold_all_points_and_little_more():
    random = np.random.default_rng(1)
    for _ in range(20):
        points = random.normal(size=(80, 3)) * random.uniform(0.02, 0.4, 3) + random.normal(size=3)
        start, end, radius = enclose(points)
        along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        away = np.linalg.norm(points - start - np.outer(along, end - start), axis=1)
        assert away.max() <= radius * (1.0 + 1e-9)
        assert radius < 1.2 * np.linalg.norm(points - points.mean(axis=0), axis=1).max()


def box_mesh(path, size):
    """An STL of a box's corners, as triangles of each face's two halves."""
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * size
    faces = [(0, 1, 3), (0, 2, 3), (4, 5, 7), (4, 6, 7), (0, 1, 5), (0, 4, 5), (2, 3, 7), (2, 6, 7)]
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *corners[list(face)].ravel(), 0) for face in faces)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + body)


@pytest.fixture
def robot(tmp_path):
    """A copy of the shipped UR5 whose upper arm has a mesh for collision."""
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    shape = '<collision><geometry><mesh filename="arm.stl"/></geometry></collision>'
    text = text.replace('<link name="upper_arm_link">', f'<link name="upper_arm_link">{shape}', 1)
    (tmp_path / "robot.urdf").write_text(text)
    box_mesh(tmp_path / "arm.stl", (0.1, 0.1, 0.6))
    return tmp_path / "robot.urdf"


def test_a_first_file_is_a_cell_that_mcs_takes(robot, capsys):
    file = robot.with_name("cell.yaml")
    assert main(["new", str(robot), "--output", str(file)]) == 0
    cell = load_cell(file)
    assert cell.joint_names == load_cell("ur5").joint_names
    assert cell.groups["arm"].tip == "tool0"
    assert [body.link for body in cell.bodies] == ["upper_arm_link"]
    assert load_config(cell=cell).groups["arm"].joints == cell.joint_names
    capsys.readouterr()
    assert main(["check", str(file), "--picture", str(robot.with_name("cell.png"))]) == 0
    told = capsys.readouterr().out
    assert "group arm: 6 joints to tool0" in told
    assert "group arm: inverse kinematics in closed form, by three parallel axes" in told
    assert "missing: cameras" in told
    assert re.search(r"assumed: shoulder_pan_joint, .*: no motor; a rotor", told)
    assert robot.with_name("cell.png").read_bytes().startswith(b"\x89PNG")


def test_fingers_stand_still_and_the_frame_between_them_is_the_tip():
    text = first_cell(cell_file("panda").with_name("panda.urdf"))
    assert "tip: panda_hand_tcp" in text
    assert "finger" not in text.partition("capsules:")[0]


def test_each_of_two_arms_is_a_group():
    text = first_cell(cell_file("ur_pair").with_name("ur_pair.urdf"))
    assert re.findall(r"tip: (\w+)", text) == ["one_tool0", "two_tool0"]


def test_pairs_of_an_srdf_are_taken(robot):
    srdf = robot.with_name("robot.srdf")
    srdf.write_text(
        '<robot name="r"><disable_collisions link1="base_link" link2="upper_arm_link" reason="Never"/></robot>'
    )
    file = robot.with_name("cell.yaml")
    file.write_text(first_cell(robot, srdf))
    assert "srdf: robot.srdf" in file.read_text()
    assert load_cell(file).untouching == {frozenset(("base_link", "upper_arm_link"))}
    srdf.write_text("<robot")
    with pytest.raises(ConfigError, match=r"srdf: .*robot.srdf: is not XML"):
        load_cell(shutil.copy(file, robot.with_name("broken.yaml")))
    srdf.unlink()
    with pytest.raises(ConfigError, match=r"srdf: .*robot.srdf: cannot be read"):
        load_cell(shutil.copy(file, robot.with_name("missing.yaml")))


def test_meshes_that_are_not_there_or_in_millimetres_are_said(robot):
    box_mesh(robot.with_name("arm.stl"), (100.0, 100.0, 600.0))
    with pytest.raises(DataError, match=r"arm.stl of link upper_arm_link is 600 m large: .* millimetres"):
        first_cell(robot)
    robot.with_name("arm.stl").unlink()
    with pytest.raises(DataError, match=r"the mesh arm.stl of link upper_arm_link: .*arm.stl is not there"):
        first_cell(robot)


def test_what_cannot_be_used_is_said_in_a_line(tmp_path, capsys):
    assert main(["check", str(tmp_path / "none.yaml")]) == 1
    assert capsys.readouterr().err.startswith("im cell: ")
    (tmp_path / "still.urdf").write_text('<robot name="r"><link name="base"/></robot>')
    assert main(["new", str(tmp_path / "still.urdf")]) == 1
    assert "no chain of two joints or more moves" in capsys.readouterr().err
