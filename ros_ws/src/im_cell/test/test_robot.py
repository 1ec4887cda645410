import xml.etree.ElementTree as ET

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from im_cell.robot import cell_file, load_cell, robot_description, urdf
from im_cell.robot.truth import load_truth
from im_core.errors import ConfigError, DataError
from support.puma import wrist_pose

CELL = load_cell()
TREE = ET.fromstring(urdf(CELL))


def numbers(text):
    return np.array([float(word) for word in text.split()])


def transform(rotation, translation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def urdf_pose(link, q):
    """Pose of a URDF link in the world by walking up the tree, shape (4, 4)."""
    positions = dict(zip(CELL.joint_names, q, strict=True))
    T = np.eye(4)
    while link != "world":
        joint = next(joint for joint in TREE.findall("joint") if joint.find("child").get("link") == link)
        origin = joint.find("origin")
        step = transform(Rotation.from_euler("xyz", numbers(origin.get("rpy"))).as_matrix(), numbers(origin.get("xyz")))
        if joint.get("type") != "fixed":
            along = numbers(joint.find("axis").get("xyz")) * positions[joint.get("name")]
            turned = joint.get("type") == "revolute"
            step = step @ (transform(Rotation.from_rotvec(along).as_matrix(), np.zeros(3)) if turned
                           else transform(np.eye(3), along))  # fmt: skip
        T, link = step @ T, joint.find("parent").get("link")
    return T


@pytest.mark.parametrize("side", ["left", "right"])
def test_urdf_has_the_kinematics_of_the_dh_table(side):
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(CELL.per_joint("limits.lower"), CELL.per_joint("limits.upper"))
        np.testing.assert_allclose(
            urdf_pose(f"{side}_wrist", q), wrist_pose(side, q[:9] if side == "left" else q[9:]), atol=1e-12
        )


def test_the_18_joints_come_in_order():
    names = ["track", "rotation", "tilt", *(f"j{number}" for number in range(1, 7))]
    assert CELL.joint_names == tuple(f"{side}_{name}" for side in ("left", "right") for name in names)
    moving = [joint.get("name") for joint in TREE.findall("joint") if joint.get("type") != "fixed"]
    assert tuple(moving) == CELL.joint_names
    assert [joint.child for joint in CELL.joints] == [link.name for link in CELL.links]


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_arm_is_what_its_base_does_not_carry(side):
    assert CELL.arm_of(side) == tuple(f"{side}_j{number}" for number in range(1, 7))
    assert CELL.carriers_of(CELL.groups[side].base) == tuple(f"{side}_{name}" for name in ("track", "rotation", "tilt"))


def test_shoulder_is_near_one_metre_and_led_is_on_the_wrist():
    assert urdf_pose("left_link2", CELL.home)[2, 3] == pytest.approx(1.0, abs=0.01)
    offset = np.linalg.inv(urdf_pose("left_wrist", CELL.home)) @ urdf_pose("left_led", CELL.home)
    np.testing.assert_allclose(offset[:3, 3], CELL.led.offset, atol=1e-12)


def test_reflected_rotor_inertias_are_those_of_the_published_arm():
    """P.I. Corke, Robotics, Vision and Control: reflected inertias of the PUMA 560 [kg m2], as G^2 J."""
    left_arm = CELL.per_joint("rotor_inertia")[3:9]
    np.testing.assert_allclose(left_arm, [0.784, 2.325, 0.577, 0.191, 0.171, 0.194], rtol=2e-3)


def test_friction_opposes_both_directions_and_swaps_with_the_sign_of_the_gear():
    assert (CELL.per_joint("coulomb_positive") > 0.0).all()
    assert (CELL.per_joint("coulomb_negative") > 0.0).all()
    j1 = CELL.joints[3]
    assert (j1.coulomb_positive, j1.coulomb_negative) == pytest.approx((62.6111 * 0.435, 62.6111 * 0.395))


def test_masses_are_physical_but_for_the_published_link_3():
    """A rigid body's principal inertias satisfy the triangle inequality."""
    for link in CELL.links:
        a, b, c = sorted(link.inertia)
        assert link.mass > 0.0
        assert (a + b >= c) != link.name.endswith("link3"), link.name


def test_encoders_resolve_better_than_a_tenth_of_a_milliradian():
    assert (CELL.per_joint("resolution") < 1e-4).all()
    assert CELL.joints[4].resolution == pytest.approx(2.0 * np.pi / (4000 * 107.815))


def test_every_urdf_shape_and_frame_is_attached_to_a_known_link():
    links = {link.get("name") for link in TREE.findall("link")}
    assert {"left_cart", "right_platform", "left_base", "right_wrist", "left_led"} <= links
    assert {capsule.link for capsule in CELL.capsules} <= links
    assert {camera.parent for camera in CELL.cameras.values()} <= links
    assert [box.name for box in CELL.obstacles] == ["floor", "table"]
    bare = ET.fromstring(urdf(CELL, frames=False, shapes=False))
    assert {link.get("name") for link in bare.findall("link")} == {"world", *(link.name for link in CELL.links)}
    assert not bare.findall(".//geometry")
    assert max(len(line) for line in urdf(CELL).splitlines()) < 300


LIMITS = {joint.name: joint.limits.model_copy(update={"velocity": 0.25}) for joint in CELL.joints}
DESCRIPTION = ET.fromstring(robot_description(CELL, LIMITS))


def test_the_description_is_the_cell_with_what_physics_leaves_out():
    links = {link.get("name") for link in DESCRIPTION.findall("link")}
    more = {f"{side}_{part}" for side in CELL.groups for part in ("palm", "jaw_1", "jaw_2")}
    assert links - {link.get("name") for link in TREE.findall("link")} == more | {
        f"{name}_body" for name in CELL.cameras
    }
    for name in CELL.joint_names:
        here, there = (tree.find(f"joint[@name='{name}']") for tree in (DESCRIPTION, TREE))
        for part in ("parent", "child", "origin", "axis"):
            assert here.find(part).attrib == there.find(part).attrib
        assert here.find("limit").get("velocity") == "0.25"
    assert max(len(line) for line in robot_description(CELL, LIMITS).splitlines()) < 300


def test_planners_meet_the_obstacles_and_physics_does_not():
    bodies = DESCRIPTION.find("link[@name='world']").findall("collision")
    found = [(numbers(b.find("origin").get("xyz")), numbers(b.find("geometry/box").get("size"))) for b in bodies]
    np.testing.assert_allclose(found, [(box.center, box.size) for box in CELL.obstacles])
    assert TREE.find("link[@name='world']").findall("collision") == []


def test_collision_shapes_of_the_arms_are_the_same_for_planners_and_physics():
    for link in CELL.links:
        here, there = (
            [ET.tostring(shape) for shape in tree.findall(f"link[@name='{link.name}']/collision")]
            for tree in (DESCRIPTION, TREE)
        )
        assert here == there


def test_capsules_are_sheer_where_hulls_are_compared():
    ur5 = load_cell("ur5")
    limits = {joint.name: joint.limits for joint in ur5.joints}
    assert "forearm_link" in {hull.link for hull in ur5.hulls}
    for tree, opacity in ((ET.fromstring(robot_description(ur5, limits)), 0.35), (ET.fromstring(urdf(ur5)), 1.0)):
        colors = tree.find("link[@name='forearm_link']").findall("visual/material/color")
        assert {numbers(color.get("rgba"))[3] for color in colors} == {opacity}


@pytest.mark.parametrize("side", list(CELL.groups))
def test_the_joint_of_a_gripper_is_its_opening(side):
    driven, follower = (DESCRIPTION.find(f"joint[@name='{side}_{name}']") for name in ("gripper", "jaw"))
    assert [float(driven.find("limit").get(key)) for key in ("lower", "upper", "velocity", "effort")] == [
        0.0, CELL.gripper.stroke, CELL.gripper.rate, CELL.gripper.force,
    ]  # fmt: skip
    assert follower.find("mimic").attrib == {"joint": f"{side}_gripper", "multiplier": "0.5", "offset": "0.0"}
    assert float(follower.find("limit").get("upper")) == CELL.gripper.stroke / 2


def test_names_of_boxes_may_have_any_letters():
    boxes = [CELL.boxes[0].model_copy(update={"name": 'table <1> & "co"'})]
    (visual,) = ET.fromstring(urdf(CELL.model_copy(update={"boxes": boxes}))).find("link").findall("visual/material")
    assert visual.get("name") == 'table <1> & "co"_world'


def test_arms_start_apart():
    for capsule in CELL.capsules:
        for end in (capsule.p0, capsule.p1):
            T = urdf_pose(capsule.link, CELL.home)
            x = (T[:3, :3] @ end + T[:3, 3])[0]
            assert (x < 0.5) == capsule.link.startswith("left")


@pytest.mark.parametrize("name", list(CELL.cameras))
def test_cameras_look_at_their_target_with_the_right_side_up(name):
    camera = CELL.cameras[name]
    R, t = camera.pose()
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    x, y, z = R @ camera.target + t
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert z > 0.0
    assert (R @ camera.up)[1] < 0.0, "up is towards smaller rows"


@pytest.mark.parametrize(("change", "message"), [
    (lambda data: data["groups"]["left"].update(tip="left_wrst"),
     r":\d+: groups.left.tip: .*'left_wrst' is not a link of the URDF \(did you mean 'left_wrist'"),
    (lambda data: data["groups"]["left"].update(base="lft_base"), r"groups.left.base: .*'lft_base' .*'left_base'"),
    (lambda data: data["drives"].update(left_j7={}), r":\d+: drives.left_j7: .*'left_j7' is not a joint of the URDF"),
    (lambda data: data["groups"]["left"].update(home=[9.0] + [0.0] * 8), r"home\[0\]: 9 of left_track is outside"),
    (lambda data: data["groups"]["left"].update(home=[0.0] * 6),
     r"groups.left.home: 6 positions for 9 joints: left_track"),
    (lambda data: data.update(period=1e-10), r":\d+: period: .*greater than or equal to 0.0001"),
    (lambda data: data["led"].update(colour="red"), r"led.colour"),
    (lambda data: data["groups"].update(right=data["groups"]["left"]), r"joint left_track is in group 'left' already"),
    (lambda data: data["drives"]["left_tilt"]["motor"].update(gear=0.0),
     r"drives.left_tilt.motor.gear: 0.0 is no gear: its size is"),
    (lambda data: data["drives"]["left_j1"].update(jerk=1e300),
     r":\d+: drives.left_j1.jerk: .*less than or equal to 1000000000"),
    (lambda data: data["cameras"]["wall"].update(up=[0.0, 0.0, 0.0]), r"cameras.wall: .* must not be zero"),
    (lambda data: data["cameras"]["wall"].update(position=[0.0, 0.0, 5.0], target=[0.0, 0.0, 0.0], up=[0, 0, 1]),
     r"cameras.wall: up, .*, is along its view"),
    (lambda data: data["laser"].update(target=data["laser"]["position"]), r"laser: target .* must differ"),
    (lambda data: data["cameras"]["wrist_left"]["check"].update(arm="rigth"),
     r"cameras.wrist_left.check.arm: 'rigth' is not a group with a light.*'right'"),
    (lambda data: data["cameras"]["wrist_left"]["check"]["shown"][1].__setitem__(6, 5.0),
     r"cameras.wrist_left.check.shown: the quaternion .* has length 5.06"),
    (lambda data: data["cameras"]["wall"]["intrinsics"].update(width=10**9), r"intrinsics.width: .*less than or equal"),
    (lambda data: data["boxes"][2].update(link="left_link66"),
     r":\d+: boxes\[2\].link: .*'left_link66' is not a link \(did you mean 'left_link6'"),
    (lambda data: data["boxes"][2].update(name="floor"), r":\d+: boxes\[2\].name: .*the same name, 'floor'"),
    (lambda data: data["boxes"][3].update(link="left_crat"),
     r"boxes\[3\].link: .*'left_crat' is not a link \(did you mean 'left_cart'"),
    (lambda data: data["capsules"][0].update(link="link1"), r"capsules\[0\].link: .*'link1' is not a link"),
    (lambda data: data["cameras"].update({"the wall": data["cameras"]["wall"]}), "'the wall' names topics"),
    (lambda data: data["cameras"]["wall"].update(parent="left_wirst"), r"cameras.wall.parent: .*'left_wirst' is not"),
    (lambda data: data["mirrors"][0].update(link="wrld"),
     r"mirrors\[0\].link: .*'wrld' is not a link \(did you mean 'world'"),
    (lambda data: data["gripper"].update(initial=0.8), r":\d+: gripper.initial: .*0.8 is more than the stroke"),
    (lambda data: data["led"].update(axis=[0.0, 0.0, 0.0]), r":\d+: led.axis: .* has no direction"),
])  # fmt: skip
def test_a_wrong_cell_is_refused_by_name(tmp_path, change, message):
    data = yaml.safe_load(cell_file("puma_pair").read_text())
    change(data)
    data["urdf"] = str(cell_file("puma_pair").with_name("puma_pair.urdf"))
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=message):
        load_cell(path)


@pytest.mark.parametrize("period", [1e-10, 0.0, float("nan")])
def test_a_tick_in_which_no_time_passes_is_refused(period):
    with pytest.raises(ConfigError, match=r"a testbed period of \S+ s is not at least 0\.0001 s"):
        CELL.at_period(period)
    assert CELL.at_period(1e-4).period == 1e-4


def test_a_wrong_truth_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="cannot be read"):
        load_truth(tmp_path / "truth.json")
    (tmp_path / "truth.json").write_text("{}")
    with pytest.raises(DataError, match="is not a truth file"):
        load_truth(tmp_path / "truth.json")
