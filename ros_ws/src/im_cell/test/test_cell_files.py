"""Cells of any URDF: what is read, what is assumed, and what is refused in one sentence."""

import numpy as np
import pytest

from im_cell.net_parameters import net_parameters
from im_cell.robot import load_cell, urdf
from im_core.errors import ConfigError

CELL = "urdf: robot.urdf\ngroups:\n  arm: {tip: tool, home: [0.1, 0.2]}\n"
INERTIAL = '<inertial><mass value="1.0"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="10"/>'


def link(name, content=INERTIAL):
    return f'<link name="{name}">{content}</link>'


def joint(name, parent, child, kind="revolute", content=LIMIT, xyz="0 0 0.3"):
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="0 1 0"/>{content}</joint>')  # fmt: skip


def robot(*more, first=None, second=None, tool=None):
    """A base, two joints and a tool that is fixed to the second link."""
    parts = [
        link("base"), link("one"), link("two"), link("tool", ""),
        joint("a", "base", "one") if first is None else first, joint("b", "one", "two") if second is None else second,
        joint("t", "two", "tool", "fixed", "") if tool is None else tool, *more,
    ]  # fmt: skip
    return "<robot name='r'>\n" + "\n".join(parts) + "\n</robot>"


@pytest.fixture
def read(tmp_path):
    def call(text, cell=CELL):
        (tmp_path / "robot.urdf").write_text(text)
        (tmp_path / "cell.yaml").write_text(cell)
        return load_cell(tmp_path / "cell.yaml")

    return call


def test_a_page_of_yaml_beside_a_urdf_is_a_cell(read):
    cell = read(robot())
    assert cell.joint_names == ("a", "b")
    assert cell.home.tolist() == [0.1, 0.2]
    assert list(cell.partitions) == ["each"]
    assert (cell.partitions["each"]["arm"].joints, cell.partitions["each"]["arm"].wrist) == (("a", "b"), "tool")
    assert (cell.obstacles, cell.light_names, cell.cameras, cell.laser, cell.unknown) == ((), (), {}, None, ())
    assert cell.per_joint("limits.torque").tolist() == [10.0, 10.0]
    assert cell.per_joint("limits.acceleration").tolist() == [8.0, 8.0]
    assert "a, b: no limit of acceleration; full speed after 0.25 s" in cell.assumed
    assert '<joint name="a" type="revolute">' in urdf(cell)


def test_a_workspace_is_that_of_the_file_and_never_of_another_cell(read):
    camera = "cameras:\n  eye: {parent: world, position: [1, 0, 1], target: [0, 0, 0], up: [0, 0, 1], "
    camera += "intrinsics: {width: 640, height: 480, fx: 600, fy: 600, cx: 319.5, cy: 239.5}}\n"
    said = "no workspace; errors of calibrated cameras are given where their light was"
    assert said not in read(robot()).assumed, "there are no cameras"
    without = read(robot(), CELL + camera)
    assert without.workspace_box is None
    assert said in without.assumed
    given = read(robot(), CELL + camera + "workspace: [[0, 0, 0], [0.1, 0.2, 0.3]]\n")
    assert given.workspace_box.high == (0.1, 0.2, 0.3)
    assert said not in given.assumed
    with pytest.raises(ConfigError, match=r"workspace: The workspace from .* has a side that is not longer than zero"):
        read(robot(), CELL + "workspace: [[0, 0, 0], [0.1, 0.0, 0.3]]\n")


def test_where_the_light_and_the_jaws_are_is_told_where_nobody_says_it(read):
    light, stroke, reach = (
        "no offset of the light (led); it is at (0, 0.06, 0.05) m in the frame of the tip",
        "no stroke of the gripper; it is 0.08 m",
        "no reach of the gripper from the tip to its jaws; it is 0.15 m",
    )
    assert not {light, stroke, reach} & set(read(robot()).assumed)
    both = CELL.replace("tip: tool,", "tip: tool, light: true, gripper: true,")
    assert {light, stroke, reach} <= set(read(robot(), both).assumed)
    told = read(robot(), both + "led: {offset: [0, 0, 0.1]}\ngripper: {reach: 0.0}\n").assumed
    assert {light, stroke, reach} & set(told) == {stroke}


def test_a_urdf_in_a_package_is_found(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "my_robot" / "urdf"
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(robot())
    (tmp_path / "cell.yaml").write_text(CELL.replace("robot.urdf", "package://my_robot/urdf/robot.urdf"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert load_cell(tmp_path / "cell.yaml").joint_names == ("a", "b")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/nowhere")
    (tmp_path / "cell.yaml").write_text(CELL.replace("robot.urdf", "package://their_robot/urdf/robot.urdf"))
    with pytest.raises(ConfigError, match=r"package their_robot with 'urdf/robot\.urdf' is in no workspace"):
        load_cell(tmp_path / "cell.yaml")


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:macro name="limb" params="name joint parent">
  <link name="${name}"/>
  <joint name="${joint}" type="revolute"><parent link="${parent}"/><child link="${name}"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 ${0.1 * 3}"/><limit lower="${-pi / 2}" upper="${pi / 2}" velocity="2" effort="10"/></joint>
</xacro:macro>
<link name="base"/><xacro:limb name="one" joint="a" parent="base"/><xacro:limb name="tool" joint="b" parent="one"/>
</robot>"""


def test_a_xacro_is_expanded(read, tmp_path):
    cell = CELL.replace("robot.urdf", "robot.urdf.xacro")
    (tmp_path / "robot.urdf.xacro").write_text(XACRO)
    found = read("", cell)
    assert found.joint_names == ("a", "b")
    assert found.joints[1].xyz == pytest.approx((0.0, 0.0, 0.3))
    assert found.per_joint("limits.upper") == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            '<link name="base"/>',
            '<xacro:include filename="$(find nowhere)/x"/>',
            "expand it: \"package 'nowhere' not found",
        ),
        ("<xacro:limb", "<xacro:leg", "xacro cannot expand it: unknown macro name: xacro:leg"),
        ("0.1 * 3", "1 / 0", "xacro cannot expand it: division by zero"),
        ("</robot>", "", "xacro cannot expand it: no element found"),
        ('xmlns:xacro="http://www.ros.org/wiki/xacro"', "", "xacro cannot expand it: unbound prefix"),
        ('<link name="base"/>', "", "joint a names the link 'base', which is not there"),
    ],
)
def test_a_xacro_that_cannot_be_expanded_is_refused(read, tmp_path, before, after, message):
    (tmp_path / "robot.urdf.xacro").write_text(XACRO.replace(before, after))
    with pytest.raises(ConfigError, match=message):
        read("", CELL.replace("robot.urdf", "robot.urdf.xacro"))


def test_links_that_are_fixed_are_one_body_and_joints_of_no_group_stand_where_they_are_told(read):
    finger = joint(
        "f", "two", "finger", "prismatic", '<limit lower="0" upper="0.1" velocity="1" effort="5"/>', "0 0 0.1"
    )
    cell = read(robot(link("finger"), finger), CELL + "standing: {f: 0.05}\n")
    assert [body.mass for body in cell.links] == [1.0, 2.0]
    np.testing.assert_allclose(cell.links[1].com, [0.0, 0.025, 0.05], atol=1e-15)
    assert cell.tree.carrier("finger").xyz == (0.0, 0.05, 0.1)
    assert any("joint f is in no group and stands still" in told for told in cell.assumed)


def test_shapes_of_the_urdf_are_enclosed_by_capsules(read):
    box = '<collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision>'
    round_ = '<collision><geometry><cylinder radius="0.04" length="0.2"/></geometry></collision>'
    cell = read(robot(link("pad", box), link("ring", round_), joint("p", "two", "pad", "fixed", ""),
                      joint("r", "two", "ring", "fixed", "")))  # fmt: skip
    pad, ring = cell.bodies
    assert (pad.link, pad.p0, pad.p1) == ("pad", (0.0, 0.0, -0.25), (0.0, 0.0, 0.25))
    assert pad.radius == pytest.approx(np.hypot(0.05, 0.05))
    assert (ring.p1, ring.radius) == ((0.0, 0.0, 0.1), 0.04)


def test_continuous_joints_have_a_turn_to_both_sides_and_that_is_said(read):
    limit = '<limit lower="0" upper="0" velocity="2" effort="10"/>'
    cell = read(robot(first=joint("a", "base", "one", "continuous", limit)))
    assert cell.joints[0].kind == "revolute"
    assert cell.joints[0].limits.upper == pytest.approx(2.0 * np.pi)
    assert "a: no range; a turn to both sides" in cell.assumed


@pytest.mark.parametrize(("limit", "range_"), [('lower="-1.5"', (-1.5, 0.0)), ('upper="1.5"', (0.0, 1.5))])
def test_of_two_limits_the_missing_one_is_0(read, limit, range_):
    """So says the specification of URDF."""
    cell = read(robot(first=joint("a", "base", "one", content=f'<limit {limit} velocity="1" effort="10"/>')),
                CELL.replace("[0.1, 0.2]", "[0.0, 0.2]"))  # fmt: skip
    assert (cell.joints[0].limits.lower, cell.joints[0].limits.upper) == range_


def test_what_torques_need_is_told_apart(read):
    bare = robot(first=joint("a", "base", "one", content='<limit lower="-1" upper="1" velocity="1" effort="0"/>'))
    cell = read(bare.replace(link("two"), link("two", "")))
    assert cell.unknown == ("joint a has no limit of effort", "link two has no mass")
    assert read(bare, CELL + "drives: {a: {torque: 7.0}}\n").unknown == ()


MIMIC = LIMIT + '<mimic joint="a"/>'
MESH = '<collision><geometry><mesh filename="package://x/y.stl"/></geometry></collision>'


@pytest.mark.parametrize(("text", "cell", "message"), [
    ("<robot", CELL, "robot.urdf: is not XML: "),
    ("<robot/>", CELL, "it has no links"),
    (robot(second=joint("b", "one", "two", content=LIMIT.replace("-1", "-1e16"))), CELL,
     "b: lower: '-1e16' is not 1 number below 1e9"),
    ("<sdf/>", CELL, "its outermost element is <sdf>, not <robot>"),
    (robot(link("stray")), CELL, "2 links are roots: base, stray; one link, which nothing carries, must carry all"),
    (robot(joint("c", "base", "two")), CELL, "link two hangs on two joints, b and c: a closed chain"),
    (robot(link("x"), link("y"), joint("c", "x", "y"), joint("d", "y", "x")), CELL, "joints c, d are a closed chain"),
    (robot(second=joint("b", "one", "twoo")), CELL, "joint b names the link 'twoo', which is not there"),
    (robot(second=joint("b", "one", "two", "planar")), CELL, "joint b is of type 'planar', not one of revolute"),
    (robot(second=joint("b", "one", "two", content=MIMIC)), CELL,
     r"cell.yaml:3: groups.arm.tip: joint b carries tool and follows a .mimic.: no such joint moves here; standing.b"),
    (robot(second=joint("b", "one", "two", content=MIMIC)),
     CELL.replace("tip: tool,", "tip: tool, joints: [a, b],"), "joint b follows a .mimic.; such joints"),
    (robot(second=joint("b", "one", "two", "prismatic", '<limit velocity="1" effort="1"/>')), CELL,
     "joint b slides without a range; drives.b.range can say one"),
    (robot(second=joint("b", "one", "two", content='<limit lower="0" upper="0" velocity="1" effort="1"/>')), CELL,
     "joint b has the range 0 to 0; drives.b.range can say one"),
    (robot(second=joint("b", "one", "two", xyz="0 0 300")), CELL, "b: 300 m is beyond 50 m: .*millimetres"),
    (robot(first=joint("a", "base", "one", xyz="0 0 40"), second=joint("b", "one", "two", xyz="0 30 0")), CELL,
     "its links are up to 70.3 m from base, beyond 50 m: lengths are millimetres"),
    (robot().replace('ixx="0.1"', 'ixx="2500"'), CELL, "has 2500 kg m2, as if 50 m away .*: inertias are kg mm2"),
    (robot(second=joint("b", "one", "two", content='<limit upper="-1" velocity="1" effort="1"/>')), CELL,
     "joint b: its limit lower 0.0 is above upper -1.0"),
    (robot().replace('"two"', f'"{"l" * 120}"'), CELL, "its name has 120 letters; 100 are allowed"),
    (robot(link("hand", "<collision><geometry><capsule/></geometry></collision>"), joint("h", "two", "hand", "fixed")),
     CELL, "hand: a shape for collision is none of box, cylinder, sphere, mesh"),
    (robot().replace("one", "world"), CELL, "cell.yaml:1: urdf: link 'world' is not its root; no other link may"),
    (robot().replace("base", "world"), CELL + "mount: {xyz: [1.0, 0.0, 0.0]}\n",
     "cell.yaml:4: mount: the root of the URDF is 'world' itself, which stands nowhere else"),
    (robot(second=joint("b", "one", "two", content='<limit lower="-90" upper="120" velocity="1" effort="1"/>')), CELL,
     "joint b turns from -90 to 120 rad: its limits are degrees, it seems"),
    (robot(second=joint("b", "one", "two", content='<limit lower="-1" upper="1" velocity="90" effort="1"/>')), CELL,
     "joint b turns at up to 90 rad/s: its limit of velocity has degrees, it seems"),
    (robot(second=joint("b", "one", "two", "prismatic", '<limit lower="0" upper="1" velocity="250" effort="1"/>')),
     CELL, "joint b slides at up to 250 m/s: its limit of velocity has millimetres, it seems"),
    (robot(second=joint("b", "one", "two", content=LIMIT + '<mimic joint="x"/>')), CELL,
     "joint b follows 'x' .mimic., which is not there"),
    (robot(second=joint("b", "one", "two", content=LIMIT + '<mimic joint="b"/>')), CELL, "joint b follows itself"),
    (robot().replace("<mass", '<origin xyz="0 0 80"/><mass'), CELL,
     "base: its <inertial>: 80 m is beyond 50 m: lengths are millimetres, it seems"),
    (robot(second=joint("b", "one", "two", xyz='0 0 0" rpy="0 -90 0')), CELL,
     "b: it is turned by -90 rad: angles are degrees, it seems"),
    (robot().replace("<mass", '<origin rpy="0 0 45"/><mass'), CELL,
     "base: its <inertial>: it is turned by 45 rad: angles are degrees, it seems"),
    (robot(), CELL + "mount: {xyz: [0.0, 800.0, 0.0]}\n",
     r"cell.yaml:4: mount.xyz: .*800 m is beyond 50 m: .*millimetres"),
    (robot(), CELL + "mount: {rpy: [0.0, 0.0, 180.0]}\n", r"cell.yaml:4: mount.rpy: .*turned by 180 rad: .*degrees"),
    (robot(link("hand", '<collision><geometry><box size="300 300 20"/></geometry></collision>'),
           joint("h", "two", "hand", "fixed", "")), CELL, "hand: a shape for collision is 300 m large: .*millimetres"),
    (robot().replace('<mass value="1.0"', '<origin xyz="0 0.2 0.1"/><mass value="2300"'), CELL,
     r"joint a has 10 Nm, and link one of 2300 kg needs up to \S+ Nm: masses are grams, it seems"),
    (robot().replace('ixy="0"', 'ixy="0.3"'), CELL, "base: its principal moments of inertia, .* -0.2, cannot be"),
    (robot().replace("two", "R&amp;D"), CELL, "link 'R&D': no name may have the sign &"),
    (robot(second=joint("b", "one", "two", xyz="0 zero 0")), CELL, "b: '0 zero 0' is not 3 numbers below 1e9"),
    (robot(second=joint("b-1", "one", "two")), CELL, "joint 'b-1': ROS takes no such name; letters, digits and _"),
    (robot(link("hand", MESH), joint("h", "two", "hand", "fixed", "")), CELL,
     "shape of link hand for collision is the mesh package://x/y.stl, and the cell has no capsules; `im cell new`"),
    (robot(link("two")), CELL, "two links have the same name, 'two'"),
    (robot(*(link(f"l{n}") for n in range(500))), CELL, r"it has \d+ links; 500 are allowed"),
    (robot(second=joint("b", "one", "two", content='<limit lower="2" upper="1" velocity="1" effort="1"/>')), CELL,
     "joint b: its limit lower 2.0 is above upper 1.0"),
    (robot(second=joint("b", "one", "two", content='<limit lower="0" upper="1" velocity="1" effort="-5"/>')), CELL,
     "joint b: its limit of effort is -5; more than 0 is needed"),
    (robot(second=joint("b", "one", "two", content='<limit lower="0" upper="1" velocity="-1" effort="5"/>')), CELL,
     "joint b: its limit of velocity is -1; more than 0 is needed"),
    (robot(link("hand", '<collision><geometry><box size="1 -1 1"/></geometry></collision>'),
           joint("h", "two", "hand", "fixed", "")), CELL, "hand: a shape for collision has the size -1; more than 0"),
    (robot(link("hand", MESH.replace("package://x/y.stl", "")), joint("h", "two", "hand", "fixed", "")), CELL,
     "hand: a mesh for collision has no file name"),
    (robot(link("hand", MESH.replace("/></geo", ' scale="1 0 1"/></geo')), joint("h", "two", "hand", "fixed", "")),
     CELL, "hand: a shape for collision has the size 0; more than 0"),
    (robot().replace('mass value="', 'mass value="-'), CELL, "has a mass or a moment of inertia below 0"),
    (robot(), CELL.replace("tip: tool", "tip: tol"), r"cell.yaml:3: groups.arm.tip: .*'tol' is not a link .*'tool'"),
    (robot(), CELL + "drives:\n  aa: {jerk: 3.0}\n", r"cell.yaml:5: drives.aa: .*'aa' is not a joint of the URDF"),
    (robot(), CELL + "standing: {c: 0.0}\n", r"cell.yaml:4: standing.c: .*'c' is not a joint of the URDF"),
    (robot(), CELL.replace("tip", "joints: [a, b], tip") + "standing: {a: 0.0}\n",
     r"cell.yaml:4: standing.a: joint a is in group 'arm', and moves"),
    (robot(second=joint("b", "one", "two", content=MIMIC)), CELL.replace("[0.1, 0.2]", "[0.1]") + "standing: {b: 3}\n",
     r"cell.yaml:4: standing.b: 3 is outside the range -1 to 1"),
    (robot(), CELL + "presets: {p: {x: {joints: [c]}}}\n", r"cell.yaml:4: presets.p.x.joints\[0\]: 'c' is not a joint"),
    (robot(), CELL + "presets: {p: {x: {joints: [a], wrist: tol}}}\n", r"p.x.wrist: 'tol' is not a link .*'tool'"),
    (robot(), CELL + "presets: {p: {x: {joints: [a], pair: [tool, oe]}}}\n", r"pair\[1\]: 'oe' is not a link"),
    (robot().replace("one", "arm_led"), CELL.replace("tip", "light: true, tip"), "'arm_led' would be a part at"),
    (robot().replace("one", "arm_jaw_1"), CELL.replace("tip", "gripper: true, tip"), "'arm_jaw_1' would be a part at"),
    (robot(), CELL + "boxes: [{link: world, name: two, size: [1, 1, 1], center: [0, 0, -3], color: [1, 1, 1]}]\n",
     r"boxes\[0\].name: another box, or a link, has the same name, 'two'"),
    (robot(), CELL.replace("[0.1, 0.2]", "[0.1]"), r"groups.arm.home: .*1 positions for 2 joints: a, b"),
    (robot(), CELL.replace("[0.1, 0.2]", "[0.1, 2.0]"),
     r"cell.yaml:3: groups.arm.home\[1\]: 2 of b is outside its range, -1 to 1"),
    (robot(), CELL.replace("  arm:", "  my-arm:"), "'my-arm' names topics"),
    (robot(), CELL.replace("robot.urdf", "robbot.urdf"), r"cell.yaml:1: urdf: .*robbot.urdf: cannot be read"),
    (robot(), CELL + "never: [[two, floor2]]\n", r"never\[0\]: .*'floor2' is not a link"),
])  # fmt: skip
def test_what_no_machine_can_use_is_refused_in_a_sentence(read, text, cell, message):
    with pytest.raises(ConfigError, match=message):
        read(text, cell)


def test_a_torso_that_is_the_joint_of_one_arm_turns_in_no_other(tmp_path, monkeypatch):
    """``demo`` turns the first joint of each arm that turns: neither a lift, nor a joint of the other arm."""
    text = robot(link("other"), joint("c", "one", "other"), first=joint("a", "base", "one", "prismatic"))
    (tmp_path / "robot.urdf").write_text(text)
    other = "  second: {tip: other, joints: [c], home: [0.7]}\n"
    (tmp_path / "cell.yaml").write_text(CELL + other)
    monkeypatch.setenv("IM_CELL", str(tmp_path / "cell.yaml"))
    assert net_parameters()["turned"] == [[0.1, pytest.approx(0.6)], [pytest.approx(0.3)]]


def test_limits_of_0_are_limits_that_the_file_does_not_know(read):
    text = robot(second=joint("b", "one", "two", content='<limit lower="0" upper="1" velocity="0" effort="0"/>'))
    cell = read(text, CELL)
    assert "joint b has no limit of effort" in cell.unknown
    assert any(told.startswith("b: no limit of velocity") for told in cell.assumed), cell.assumed


def test_a_name_that_no_cell_has_is_refused_with_the_nearest_one():
    with pytest.raises(ConfigError, match=r"there is no cell 'ur6', neither a file nor a shipped one.*'ur5'"):
        load_cell("ur6")
