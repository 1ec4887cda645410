"""Free bodies: they lie, are held by contact and friction, slip, fall, and do the same each time."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.link import Drive
from im_cell.robot import Cell, FreeBody, load_cell, urdf
from im_core.config import package_file
from im_core.errors import ConfigError
from im_sim.plant import Plant

N = 18
#: The arm bends so that the jaws point down and open along x.
DOWN = np.array([0.0, 0.0, 0.0, 1.2, 1.2, -1.9, 0.0, -0.8, 0.0])


@pytest.fixture
def cell(monkeypatch):
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
    return load_cell()


@pytest.fixture
def plant(cell):
    plant = Plant(cell, seed=1)
    yield plant
    plant.close()


def run(plant, ticks, opening=0.08, force=60.0):
    for _ in range(ticks):
        plant.run_tick(Drive(np.zeros(N), True, np.ones(N, bool), np.full(2, opening), True, np.full(2, force)))
        plant.sensors(0)  # of whatever the jaws touch


def between_jaws(cell: Cell, q, wrist="left_wrist") -> pin.SE3:
    """The pose of a frame between the jaws at a wrist: z up, as far as the jaws' x axis lets it."""
    model = pin.buildModelFromXML(urdf(cell, shapes=False))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    jaws = data.oMf[model.getFrameId(wrist)] * pin.SE3(np.eye(3), np.array([0.0, 0.0, cell.gripper.reach]))
    x, z = jaws.rotation[:, 0], -jaws.rotation[:, 2]
    return pin.SE3(np.stack([x, np.cross(z, x), z], axis=1), jaws.translation)


def pointing_down(plant, cell):
    """Move the left arm to where its jaws point down."""
    q = cell.home.copy()
    model = pin.buildModelFromXML(urdf(cell, shapes=False))
    data, frame = model.createData(), model.getFrameId("left_wrist")
    wanted = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([-0.5, 0.6, 1.25]))
    for _ in range(3000):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        error = pin.log6(data.oMf[frame].actInv(wanted)).vector
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)[:, :9]
        q[:9] += 0.2 * J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(6), error)
    assert np.linalg.norm(error) < 1e-6, "it reaches there"
    plant._world.reset(q, np.zeros(N))
    plant.q, plant.v = plant._world.state()
    return q


def test_what_is_placed_on_the_table_lies_there(plant, cell):
    run(plant, 400)
    starts = np.array([body.start for body in cell.objects])
    assert np.abs(plant.bodies()[:, :3] - starts[:, :3]).max() < 1e-3
    assert np.abs(plant.q - cell.home).max() < 2e-4, "arms that are braked stay"


def test_a_body_is_held_by_friction_slips_with_less_force_and_falls_out_of_open_jaws(plant, cell):
    q = pointing_down(plant, cell)
    held = between_jaws(cell, q)
    start = held.translation - 0.055 * held.rotation[:, 2]  # as high between the jaws as the palm lets it
    quaternion = pin.Quaternion(held.rotation).coeffs()
    run(plant, 60, opening=cell.objects[0].size[0] + 0.006)
    plant.place(0, np.array([*start, *quaternion]))
    run(plant, 100, opening=0.0)
    body, first = cell.objects[0], plant.bodies()[0, :3]
    assert np.abs(first - start)[2] < 0.02, "it was caught"
    assert plant.gripper[0] == pytest.approx(body.size[0], abs=1e-3)
    assert plant._grippers.force[0] == pytest.approx(60.0, rel=0.15)
    run(plant, 600, opening=0.0)
    assert np.abs(plant.bodies()[0, :3] - first).max() < 2e-3, "and is held"
    weight = (body.mass + 2.0 * cell.gripper.jaw_mass + cell.links[8].mass) * cell.gravity
    assert np.linalg.norm(plant.wrench[0, :3]) == pytest.approx(weight, rel=0.05), "the wrist carries it"

    least = body.mass * cell.gravity / (2.0 * body.friction)
    run(plant, 100, opening=0.0, force=3.0 * least)
    assert np.abs(plant.bodies()[0, 2] - first[2]) < 5e-3, "friction is enough for this force"
    run(plant, 100, opening=0.0, force=0.3 * least)
    assert plant.bodies()[0, 2] < first[2] - 0.05, "and not for that"
    run(plant, 300)
    assert plant.bodies()[0, 2] < 0.1, "it lies on the floor"
    assert plant._grippers.force[0] == 0.0


def test_a_body_gripped_beside_its_middle_neither_turns_nor_creeps(plant, cell):
    held = between_jaws(cell, pointing_down(plant, cell))
    level = held.rotation @ pin.utils.rotate("x", np.pi / 2.0)
    start = held.translation + 0.03 * held.rotation[:, 1]
    run(plant, 60, opening=cell.objects[0].size[0] + 0.006)
    plant.place(0, np.array([*start, *pin.Quaternion(level).coeffs()]))
    run(plant, 100, opening=0.0, force=110.0)
    first = plant.bodies()[0]
    run(plant, 445, opening=0.0, force=110.0)
    last = plant.bodies()[0]
    assert np.abs(last[:3] - first[:3]).max() < 1e-3, "in two seconds; computers differ by some tenths of a millimetre"
    assert 2.0 * np.linalg.norm(last[3:6] * first[6] - first[3:6] * last[6] - np.cross(last[3:6], first[3:6])) < 2e-3


def test_one_arm_without_a_wrist_sensor_holds_a_body_until_its_jaws_open():
    size = (0.04, 0.04, 0.06)
    block = FreeBody(name="block", kind="box", size=size, mass=0.2, color=(0, 0, 0), position=(2, 0, 0.03))
    cell = load_cell("panda").model_copy(update={"objects": (block,)})
    held = between_jaws(cell, cell.home, cell.groups["arm"].tip)
    plant, n = Plant(cell, seed=1), len(cell.joints)

    def stand(ticks, opening):
        for _ in range(ticks):
            told = np.full(1, opening), True, np.full(1, cell.gripper.force)
            plant.run_tick(Drive(np.zeros(n), True, np.ones(n, bool), *told))

    stand(150, block.size[0] + 0.006)
    plant.place(0, np.array([*held.translation, *pin.Quaternion(held.rotation).coeffs()]))
    stand(150, 0.0)
    caught = plant.bodies()[0, :3]
    stand(300, 0.0)
    assert plant.gripper[0] == pytest.approx(block.size[0], abs=1e-3)
    assert np.abs(plant.bodies()[0, :3] - caught).max() < 2e-3
    assert np.abs(plant.q - cell.home).max() < 2e-3
    stand(300, cell.gripper.stroke)
    assert plant.bodies()[0, 2] < caught[2] - 0.1
    plant.close()


def test_the_same_seed_and_commands_give_the_same_bits(cell):
    ends = []
    for _ in range(2):
        plant = Plant(cell, seed=3)
        pose = between_jaws(cell, cell.home)
        plant.place(1, np.array([*pose.translation, *pin.Quaternion(pose.rotation).coeffs()]))
        run(plant, 300, opening=0.0)
        ends.append((plant.q.tobytes(), plant.bodies().tobytes(), plant.gripper.tobytes()))
        plant.close()
    assert ends[0] == ends[1]


def test_files_of_objects_that_cannot_be_are_refused(tmp_path, monkeypatch):
    file = tmp_path / "objects.yaml"
    monkeypatch.setenv("IM_OBJECTS", str(file))
    line = "  - {name: a, kind: cylinder, size: [0.1, %s, 0.1], mass: 1.0, color: [0, 0, 0], position: [0, 0, 1]}\n"
    file.write_text("objects:\n" + line % 0.2, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"objects.yaml:2: .*the diameters of .* differ"):
        load_cell()
    file.write_text("objects:\n" + 2 * (line % 0.1), encoding="utf-8")
    with pytest.raises(ConfigError, match="two objects have the same name, 'a'"):
        load_cell()
