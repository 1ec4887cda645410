"""Arms off their drawing: as far as said, alike in physics, cameras and encoders, and as the derivatives tell."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import kinematic_derivatives, load_cell, urdf
from im_cell.robot.truth import CellTruth, errors_of
from im_sim.cameras.scene import SceneMirror
from im_sim.plant import Plant
from im_sim.truth import draw_truth

CELL = load_cell()
OFFSET = np.array(CELL.led.offset)


def light(cell, tip, q):
    """Where the light of a wrist is at joint positions."""
    model = pin.buildModelFromXML(urdf(cell, shapes=False))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(tip)].act(OFFSET)


@pytest.mark.parametrize("name", ["puma_pair", "ur5", "so101"])
def test_the_tool_is_off_by_what_is_said(name):
    cell = load_cell(name)
    built = draw_truth(cell, 3).built(cell)
    drawn, true = (pin.buildModelFromXML(urdf(each, shapes=False)) for each in (cell, built))
    rng = np.random.default_rng(5)
    low, high = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
    for group in cell.groups.values():
        off = []
        for q in rng.uniform(low, high, (200, len(low))):
            places = []
            for model in (drawn, true):
                data = model.createData()
                pin.framesForwardKinematics(model, data, q)
                places.append(data.oMf[model.getFrameId(group.tip)].translation)
            off.append(np.linalg.norm(places[1] - places[0]))
        assert 0.15e-3 < np.sqrt(np.mean(np.square(off))) < 1.5e-3


def test_each_arm_has_errors_of_its_own_and_a_perfect_one_none():
    first, second = (draw_truth(CELL, seed) for seed in (1, 2))
    assert set(first.joints) == set(CELL.joint_names)
    assert first.joints["left_j1"] not in (first.joints["right_j1"], second.joints["left_j1"])
    slides = [joint.name for joint in CELL.joints if joint.kind == "prismatic"]
    assert slides
    assert all(first.joints[name].gear_rad == (0.0,) * 4 for name in slides)
    perfect = draw_truth(CELL, 1, perfect_arm=True)
    assert perfect.joints == {}
    assert perfect.cameras == first.cameras
    assert urdf(perfect.built(CELL)) == urdf(CELL)
    assert CellTruth.model_validate_json(first.model_dump_json()) == first


@pytest.mark.parametrize("tip", ["left_wrist", "right_wrist"])
def test_the_light_is_off_as_the_derivatives_at_the_encoders_tell(tip):
    truth = draw_truth(CELL, 4)
    built = truth.built(CELL)
    plant = Plant(built, seed=1)
    try:
        told = plant.sensors(0).q
        true = plant.q
    finally:
        plant.close()
    jacobian = kinematic_derivatives(CELL, tip, dict(zip(CELL.joint_names, told.tolist(), strict=True)), OFFSET)
    off = light(built, tip, true) - light(CELL, tip, told)
    expected = jacobian @ errors_of(CELL, tip, truth.joints)
    assert np.linalg.norm(expected) > 1e-4
    np.testing.assert_allclose(off, expected, atol=1e-5)


def test_cameras_see_the_links_where_the_true_arm_has_them():
    built = draw_truth(CELL, 4).built(CELL)
    scene = SceneMirror(built, "tiny")
    try:
        scene.set_joints(CELL.home)
        rotation, origin = scene.pose("left_wrist")
    finally:
        scene.close()
    np.testing.assert_allclose(rotation @ OFFSET + origin, light(built, "left_wrist", CELL.home), atol=1e-6)
    assert np.linalg.norm(rotation @ OFFSET + origin - light(CELL, "left_wrist", CELL.home)) > 1e-4
