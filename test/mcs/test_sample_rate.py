"""How often positions of joints and states of controllers are told."""

import numpy as np
import pytest
from control_msgs.msg import JointTrajectoryControllerState
from rclpy.parameter import Parameter

from support.mcs_config import write_mcs_config


@pytest.mark.parametrize(("rate", "step_s"), [(250.0, 0.0045), (20.0, 0.05)])
def test_joints_and_controllers_are_told_as_often_as_the_parameters_say(run_machine, tmp_path, rate, step_s):
    """A servo of 4.5 ms tells them 222 times a second where 250 are asked for: once a tick."""
    with run_machine(write_mcs_config(tmp_path), joint_state_rate=rate) as machine:
        machine.mcs.set_parameters([Parameter("controller_state_rate", value=250.0)])
        told = machine.listen(JointTrajectoryControllerState, "/left/controller_state")
        machine.to_cold()
        machine.to_motion()
        assert machine.move(machine.home + machine.step).success
        for messages in (machine.positions, told):
            stamps = np.array([each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in messages])
            assert len(stamps) > 20
            assert np.median(np.diff(stamps)) == pytest.approx(step_s, abs=0.0045 if step_s > 0.0045 else 1e-6)
