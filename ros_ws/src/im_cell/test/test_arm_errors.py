"""Derivatives of a point by the errors of an arm's joints, against differences of its places."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import kinematic_derivatives, load_cell, urdf
from im_cell.robot.arm_errors import usual_errors

CELL = load_cell()
OFFSET = np.array(CELL.led.offset)


def place(model, tip, q):
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(tip)].act(OFFSET)


@pytest.mark.parametrize("tip", ["left_wrist", "right_wrist"])
def test_derivatives_are_differences_of_arms_with_joints_turned_and_shifted(tip):
    q = CELL.home + np.random.default_rng(7).uniform(-0.3, 0.3, len(CELL.home))
    jacobian = kinematic_derivatives(CELL, tip, dict(zip(CELL.joint_names, q.tolist(), strict=True)), OFFSET)
    carriers, drawn = CELL.carriers_of(tip), pin.buildModelFromXML(urdf(CELL, shapes=False))
    joints, first = {joint.name: joint for joint in CELL.joints}, 0
    for name in carriers:
        for k in range(6):
            error, built = np.where(np.arange(6) == k, 1e-3 * usual_errors(joints[name])[:6], 0.0), drawn.copy()
            joint = built.getJointId(name)
            stand = pin.SE3(pin.exp3(error[:3]), error[3:])
            built.jointPlacements[joint] = built.jointPlacements[joint] * stand
            moved = (place(built, tip, q) - place(drawn, tip, q)) / 1e-3
            np.testing.assert_allclose(jacobian[:, first + k], moved, atol=1e-8)
        first += 6
        if joints[name].kind == "revolute":
            at = CELL.joint_names.index(name)
            for k, wave in enumerate((np.sin(q[at]), np.cos(q[at]), np.sin(2.0 * q[at]), np.cos(2.0 * q[at]))):
                off = np.where(np.arange(len(q)) == at, 1e-6 * wave, 0.0)
                moved = (place(drawn, tip, q + off) - place(drawn, tip, q)) / 1e-6 * 3e-4
                np.testing.assert_allclose(jacobian[:, first + k], moved, atol=1e-8)
            first += 4
    assert jacobian.shape == (3, first)
