"""``im cell``: a first cell file of a URDF, and what a cell file leaves open."""

import itertools
import re
import shutil
import struct

import numpy as np
import pytest
import yaml
from matplotlib.patches import Polygon
from scipy.optimize import nnls

from im_cell.robot import cell_file, load_cell, shipped_cells
from im_core.errors import ConfigError, DataError
from im_mcs.cell.capsules import enclose
from im_mcs.cell.command import main
from im_mcs.cell.hulls import simplified
from im_mcs.cell.picture import draw, outline
from im_mcs.cell.template import first_cell
from im_mcs.collision import Bodies, CollisionChecker, lever_bounds
from im_mcs.collision.bodies import faces_of
from im_mcs.limits.configuration import load_config
from im_mcs.model import CellModel


def test_capsules_hold_all_points_and_little_more():
    random = np.random.default_rng(1)
    for _ in range(20):
        points = random.normal(size=(80, 3)) * random.uniform(0.02, 0.4, 3) + random.normal(size=3)
        start, end, radius = enclose(points)
        along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        away = np.linalg.norm(points - start - np.outer(along, end - start), axis=1)
        assert away.max() <= radius * (1.0 + 1e-9)
        assert radius < 1.2 * np.linalg.norm(points - points.mean(axis=0), axis=1).max()


def away_from_hull(corners, point):
    """Distance of a point from the convex hull of corners, by the best of their mixtures (non-negative squares)."""
    heavy = 1e3
    rows = np.vstack([corners.T - point[:, None], np.full(len(corners), heavy)])
    shares, _ = nnls(rows, np.array([0.0, 0.0, 0.0, heavy]))
    return np.linalg.norm(shares @ corners / shares.sum() - point)


@pytest.mark.parametrize("count", [4, 9, 500])
def test_a_hull_of_few_corners_holds_all_points_and_little_more(count):
    random = np.random.default_rng(count)
    for _ in range(5):
        points = random.normal(size=(count, 3)) * random.uniform(0.02, 0.4, 3) + random.normal(size=3)
        corners, margin = simplified(points)
        assert len(corners) <= 32
        assert {tuple(each) for each in corners} <= {tuple(each) for each in np.round(points, 4)}
        assert max(away_from_hull(corners, point) for point in points) <= margin + 1e-6
        assert margin < 0.15 * np.ptp(points, axis=0).max()


def test_a_corner_may_have_hundreds_of_neighbours():
    """As of a finely drawn cylinder, whose flat ends are cut into triangles that share a corner."""
    turns = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    circle = np.column_stack([0.05 * np.cos(turns), 0.05 * np.sin(turns)])
    points = np.vstack([np.column_stack([circle, np.full(len(turns), height)]) for height in (0.0, 0.2)])
    corners, margin = simplified(np.vstack([points, [(0.0, 0.0, 0.25)]]))
    assert len(corners) <= 32
    assert margin < 5e-3


def test_a_joint_may_have_the_name_of_a_link(tmp_path):
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    (tmp_path / "ur5.urdf").write_text(text.replace('"elbow_joint"', '"tool0"').replace('"wrist_1_joint"', '"arm_1"'))
    text = cell_file("ur5").read_text().replace("elbow_joint", "tool0").replace("wrist_1_joint", "arm_1")
    (tmp_path / "cell.yaml").write_text(re.sub("poses: .*", "", text))
    cell, same = load_cell(tmp_path / "cell.yaml"), load_cell("ur5")
    model, usual = CellModel(cell), CellModel(same)
    q = cell.home + 0.1
    np.testing.assert_allclose(model.pose(q, "tool0"), usual.pose(q, "tool0"), atol=1e-15)
    assert CollisionChecker(model, 0.0).closest(q).distance == CollisionChecker(usual, 0.0).closest(q).distance


def test_a_joint_may_have_the_name_of_a_link_and_fixed(tmp_path):
    """As joints that only hold a frame often have; here, one of them turns."""
    text = cell_file("ur5").with_name("ur5.urdf").read_text().replace('"elbow_joint"', '"tool0_fixed"')
    (tmp_path / "robot.urdf").write_text(text)
    (tmp_path / "cell.yaml").write_text(first_cell(tmp_path / "robot.urdf"))
    assert CellModel(load_cell(tmp_path / "cell.yaml")).names[2] == "tool0_fixed"


def test_an_arm_too_weak_for_the_assumed_acceleration_is_given_less(tmp_path, capsys):
    """And ``check`` tells joints that cannot follow, or do not even hold the arm."""
    bare = cell_file("ur5").with_name("ur5.urdf").read_text()
    told = {}
    for effort in ("150.0", "60", "9"):
        (folder := tmp_path / effort).mkdir()
        (folder / "robot.urdf").write_text(bare.replace('effort="150.0"', f'effort="{effort}"'))
        text = first_cell(folder / "robot.urdf")
        assert ("drives:" in text) == (effort != "150.0")
        for kept, without in ((True, text), (False, re.sub(r"(?s)drives:.*?\n\n", "", text))):
            (folder / "cell.yaml").write_text(without)
            capsys.readouterr()
            assert main(["check", str(folder / "cell.yaml")]) == 0
            told[effort, kept] = [line for line in capsys.readouterr().out.splitlines() if line.startswith("too ")]
    assert told["150.0", True] == told["60", True] == []
    (line,) = told["60", False]
    assert re.fullmatch(r"too fast: in half of all positions .*: shoulder_lift_joint [1-9]\d %", line)
    for lines in (told["9", True], told["9", False]):
        assert [line.split()[2] for line in lines] == ["shoulder_lift_joint"], lines


def test_moving_links_without_a_shape_are_told(tmp_path, capsys):
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    (tmp_path / "robot.urdf").write_text(re.sub(r"(?s)<collision>.*?</collision>", "", text))
    (tmp_path / "cell.yaml").write_text(first_cell(tmp_path / "robot.urdf"))
    capsys.readouterr()
    assert main(["check", str(tmp_path / "cell.yaml")]) == 0
    links = "shoulder_link, upper_arm_link, forearm_link, wrist_1_link, wrist_2_link, wrist_3_link"
    assert f"missing: shapes of {links}; collisions of these links are not seen" in capsys.readouterr().out
    assert main(["check", "ur5"]) == 0
    assert "missing: shapes" not in capsys.readouterr().out


def test_corners_in_one_plane_but_one_are_enough():
    """The outermost points may all lie in one plane; the one above it belongs to the hull."""
    plane = [(x, y, x + y) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]
    corners, margin = simplified(np.array([*plane, (0.05, 0.0, 0.12)]))
    assert len(corners) == 5
    assert margin <= 2e-4


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


def test_a_first_file_may_stand_in_another_folder(robot, tmp_path, monkeypatch):
    robot.with_name("robot.srdf").write_text('<robot name="r"/>')
    (tmp_path / "cells").mkdir()
    monkeypatch.chdir(tmp_path / "cells")
    for urdf, output in ((robot, "cell.yaml"), (f"../{robot.name}", str(tmp_path / "cells" / "other.yaml"))):
        assert main(["new", str(urdf), "--srdf", "../robot.srdf", "--output", output]) == 0
        data = yaml.safe_load((tmp_path / "cells" / output).read_text())
        assert (data["urdf"], data["srdf"]) == ("../robot.urdf", "../robot.srdf")
        assert load_cell(output).joint_names == load_cell("ur5").joint_names


def test_a_mesh_is_compared_as_its_hull(robot, capsys):
    """The distance from the floor is that of the box's corners, which a capsule around would shorten."""
    file = robot.with_name("cell.yaml")
    before, shape, after = re.split("(<collision>.*?</collision>)", robot.read_text(), maxsplit=1)
    robot.write_text(before + after.replace('<link name="forearm_link">', f'<link name="forearm_link">{shape}'))
    assert main(["new", str(robot), "--output", str(file)]) == 0
    cell = load_cell(file)
    (hull,) = cell.hulls
    assert sorted(hull.points) == sorted(itertools.product((-0.05, 0.05), (-0.05, 0.05), (-0.3, 0.3)))
    capsys.readouterr()
    assert main(["check", str(file)]) == 0
    told = capsys.readouterr().out
    assert "compared as a hull: forearm_link, 8 corners with 0.1 mm around; 6.00 l, its capsules " in told
    assert "compared as capsules" not in told
    model, random = CellModel(cell), np.random.default_rng(2)
    checker = CollisionChecker(model, 0.0)
    for _ in range(20):
        q = random.uniform(-2.0, 2.0, 6)
        pose = model.pose(q, "forearm_link")
        lowest = min(pose.act(np.array(corner))[2] for corner in hull.points)
        if lowest > hull.radius:
            assert checker.closest(q).distance == pytest.approx(lowest - hull.radius, abs=1e-6)
    faces = faces_of(np.array(hull.points))
    assert len(faces) == 12
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    assert np.linalg.norm(normals, axis=1).sum() / 2.0 == pytest.approx(2.0 * 0.1**2 + 4.0 * 0.1 * 0.6), "all faces"
    assert (np.einsum("ij,ij->i", normals, faces[:, 0]) > 0.0).all(), "counter-clockwise from outside"
    bound = lever_bounds(model, Bodies(model))[0, 2]
    assert bound == pytest.approx(np.hypot(0.05, 0.3), abs=1e-3)  # from the elbow's axis to an edge


def test_an_outline_is_what_a_margin_leaves_of_the_points():
    """A square with a margin has the area of the square, four strips and a circle."""
    points = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (1.0, 1.3)])
    x, y = outline(points, 0.1).T
    area = (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0
    assert area == pytest.approx(4.0 + 4 * 2.0 * 0.1 + np.pi * 0.1**2, abs=2e-3)


def test_a_picture_shows_hulls_and_the_capsules_of_other_links(robot, monkeypatch):
    cell = load_cell("so101")
    alone = cell.hulls[:1]
    monkeypatch.setattr("im_mcs.cell.picture.Polygon", lambda corners, **_: drawn.append(corners) or Polygon(corners))
    drawn, counts = [], {}
    for number, hulls in enumerate((cell.hulls, alone)):
        drawn.clear()
        draw(cell.model_copy(update={"hulls": hulls}), robot.with_name(f"{number}.png"))
        counts[number] = len(drawn)
    links = {hull.link for hull in cell.hulls}
    assert counts[0] == 3 * (len(cell.hulls) + sum(body.link not in links for body in cell.bodies))
    assert counts[1] == 3 * (1 + sum(body.link != alone[0].link for body in cell.bodies))


def test_a_mesh_without_thickness_keeps_its_capsule(robot):
    box_mesh(robot.with_name("arm.stl"), (0.2, 0.4, 5e-4))
    text = first_cell(robot)
    assert "hulls:" not in text
    assert "{link: upper_arm_link, p0: " in text


@pytest.mark.parametrize(
    ("points", "link", "sentence"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "upper_arm_link", r"hulls\[0\].points.*4"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1e-5]], "upper_arm_link", "these points are in one plane, or nearly"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "uper_arm_link", "'uper_arm_link' is not a link .*'upper_arm_"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, float("nan")]], "upper_arm_link", "nan"),
    ],
)
def test_a_hull_that_is_none_is_refused_with_its_line(tmp_path, points, link, sentence):
    shutil.copy(cell_file("ur5").with_name("ur5.urdf"), tmp_path)
    data = yaml.safe_load(cell_file("ur5").read_text()) | {"hulls": [{"link": link, "points": points, "radius": 0.0}]}
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=sentence):
        load_cell(tmp_path / "cell.yaml")


def test_fingers_stand_still_and_the_frame_between_them_is_the_tip():
    text = first_cell(cell_file("panda").with_name("panda.urdf"))
    assert "tip: panda_hand_tcp" in text
    assert "finger" not in text.partition("capsules:")[0]


def test_a_jaw_by_its_name_is_no_joint_of_the_arm_and_links_need_no_shapes(tmp_path):
    def joint(name, parent, child, limit='<limit lower="-1" upper="1" velocity="1" effort="9"/>'):
        return (f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
                f'<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>{limit}</joint>')  # fmt: skip

    links = "".join(f'<link name="{name}"/>' for name in ("base", "one", "two", "claw"))
    joints = joint("a", "base", "one") + joint("b", "one", "two") + joint("Jaw", "two", "claw")
    (tmp_path / "robot.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    (tmp_path / "cell.yaml").write_text(first_cell(tmp_path / "robot.urdf"))
    assert load_cell(tmp_path / "cell.yaml").joint_names == ("a", "b")


@pytest.mark.parametrize(("stroke", "joints"), [(0.6, 3), (0.08, 2)])
def test_a_last_joint_that_slides_is_an_axis_unless_its_stroke_is_that_of_a_jaw(tmp_path, stroke, joints):
    """Names that YAML reads as numbers, words or signs are in quotes."""
    links = ["on", "1e3", "null", "a, b"]
    text = "".join(f'<link name="{name}"/>' for name in links) + "".join(
        f'<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f'<limit lower="0" upper="{stroke if name == "n" else 1}" velocity="1" effort="9"/></joint>'
        for name, axis, parent, child in zip(
            ("y", "off", "n"), ("1 0 0", "0 1 0", "0 0 1"), links, links[1:], strict=False
        )
    )
    (tmp_path / "robot: 1.urdf").write_text(f'<robot name="r">{text}</robot>')
    (tmp_path / "cell.yaml").write_text(first_cell(tmp_path / "robot: 1.urdf"))
    cell = load_cell(tmp_path / "cell.yaml")
    assert cell.joint_names == ("y", "off", "n")[:joints]
    assert cell.groups["arm"].tip == links[joints]


def test_links_that_are_in_the_way_everywhere_are_named(tmp_path):
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    for link, size in (("base_link", 0.3), ("forearm_link", 0.3), ("wrist_3_link", 2.0)):
        shape = f'<collision><geometry><sphere radius="{size}"/></geometry></collision>'
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{shape}', 1)
    (tmp_path / "robot.urdf").write_text(text)
    (tmp_path / "robot.srdf").write_text('<robot name="r"/>')
    with pytest.raises(DataError, match=r": (base_link|wrist_3_link|floor) and (wrist_3_link|floor) meet most often"):
        first_cell(tmp_path / "robot.urdf", tmp_path / "robot.srdf")


def test_each_of_two_arms_is_a_group():
    text = first_cell(cell_file("ur_pair").with_name("ur_pair.urdf"))
    assert re.findall(r"tip: (\w+)", text) == ["one_tool0", "two_tool0"]


def test_links_two_joints_apart_are_compared_unless_they_are_close_by_construction():
    """A folded UR5 has its forearm in its shoulder, a Panda its hand in link 5."""
    for name, at, links in (
        ("ur5", {"elbow_joint": 3.0}, {"forearm_link", "shoulder_link"}),
        ("ur5", {"elbow_joint": -3.14}, {"upper_arm_link", "wrist_1_link"}),
        ("panda", {"panda_joint6": 0.0, "panda_joint7": 2.89}, {"panda_hand", "panda_link5"}),
        ("so101", {"elbow_flex": 1.69}, {"lower_arm_link", "shoulder_link"}),
    ):
        cell = load_cell(name)
        places = dict(zip(cell.joint_names, cell.home.tolist(), strict=True)) | at
        bodies = Bodies(CellModel(cell))
        bodies.place(np.array(list(places.values())))
        touching = [{*bodies.pair_names(k)} for k in range(len(bodies.pairs)) if bodies.distance(k) <= 0.0]
        assert links in touching, (name, touching)


def test_a_tip_of_any_name_is_drawn(robot):
    robot.write_text(robot.read_text().replace('"tool0"', '"$\\a$"'))
    file = robot.with_name("cell.yaml")
    file.write_text(first_cell(robot))
    draw(load_cell(file), robot.with_name("cell.png"))


@pytest.mark.parametrize("name", shipped_cells())
def test_links_of_a_shipped_cell_that_are_not_compared_touch_always_or_are_close_by_construction(name):
    """Or never touch."""
    cell = load_cell(name)
    assert cell.never
    bodies = Bodies(CellModel(cell.model_copy(update={"never": ()})))
    shapes = {pair: [k for k in range(len(bodies.pairs)) if {*bodies.pair_names(k)} == {*pair}] for pair in cell.never}
    low, high = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
    distances = {pair: [] for pair in shapes}
    for q in np.random.default_rng(1).uniform(low, high, (150, len(low))):
        bodies.place(q)
        for pair, ranks in shapes.items():
            distances[pair].append(min(map(bodies.distance, ranks)))
    for pair, found in distances.items():
        assert np.median(found) < 0.03 or min(found) > 0.0, pair


def test_pairs_of_an_srdf_are_taken(robot, capsys):
    srdf = robot.with_name("robot.srdf")
    srdf.write_text(
        '<robot name="r"><disable_collisions link1="base_link" link2="upper_arm_link" reason="Never"/></robot>'
    )
    file = robot.with_name("cell.yaml")
    file.write_text(first_cell(robot, srdf))
    assert "srdf: robot.srdf" in file.read_text()
    assert load_cell(file).untouching == {frozenset(("base_link", "upper_arm_link"))}
    srdf.write_text(srdf.read_text().replace("base_link", "bass_link"))
    file.write_text(file.read_text() + "poses: poses.yaml\n")
    capsys.readouterr()
    assert main(["check", str(file)]) == 0
    told = capsys.readouterr().out
    assert "missing: links that the SRDF names: bass_link" in told
    assert "missing: the file of poses, " in told
    srdf.write_text('<robot name="r"><disable_collisions link1="base_link"/></robot>')
    with pytest.raises(ConfigError, match=r"srdf: .*robot.srdf: a <disable_collisions> lacks its link1 or link2"):
        load_cell(shutil.copy(file, robot.with_name("lacking.yaml")))
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
    box_mesh(robot.with_name("arm.stl"), (0.1, float("nan"), 0.6))
    with pytest.raises(DataError, match=r"arm.stl of link upper_arm_link: a vertex is not finite"):
        first_cell(robot)
    robot.with_name("arm.stl").write_bytes(b"solid x" + bytes(range(256)))
    with pytest.raises(DataError, match=r"^the mesh arm.stl of link upper_arm_link: Could not load .*"):
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
    assert main(["check", "ur5", "--picture", str(tmp_path / "cell.bmp")]) == 1
    assert "cell.bmp: the name of a picture ends in .png, .svg, " in capsys.readouterr().err
    assert main(["check", str(tmp_path / "still.urdf")]) == 1
    assert re.search("still.urdf: a URDF is no cell file; `im cell new .*still.urdf --output", capsys.readouterr().err)
    text = cell_file("ur5").with_name("ur5.urdf").read_text()
    (tmp_path / "named.urdf").write_text(text.replace('"elbow_joint"', '"elbow joint"'))
    assert main(["new", str(tmp_path / "named.urdf")]) == 1
    assert "named.urdf: joint 'elbow joint': ROS takes no such name" in capsys.readouterr().err
