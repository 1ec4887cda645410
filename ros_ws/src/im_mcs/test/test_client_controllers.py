"""Groups and laws in the form of controllers, and what a switch of them comes to."""

import pytest

from im_core.errors import NotFoundError, StateError
from im_mcs.client.controllers import (
    AUTO,
    BEST_EFFORT,
    FORCE_AUTO,
    STRICT,
    SwitchAction,
    SwitchStep,
    listed_controllers,
    switch_steps,
)
from im_mcs.state import State

GRAVITY, TORQUE = "im_mcs.control.pid_gravity:PidGravity", "im_mcs.control.computed_torque:ComputedTorque"
READY, REST = SwitchStep(SwitchAction.READY, "left"), SwitchStep(SwitchAction.REST, "left")


def law(name, group="left"):
    return SwitchStep(SwitchAction.LAW, group, name)


@pytest.fixture
def controllers(config):
    """``controllers(left, right)``: all there are, with the groups in these states."""

    def make(left=State.MOTION, right=State.RESERVED):
        return listed_controllers(config, {"left": left, "right": right}, {"left": GRAVITY, "right": TORQUE})

    return make


def test_a_group_that_may_move_is_chained_to_the_law_that_writes_its_efforts(controllers, config):
    listed = {controller.name: controller for controller in controllers()}
    assert {name for name, controller in listed.items() if controller.active} == {
        *("joint_state_broadcaster", "left", "left_PidGravity", "left_gripper", "right_gripper"),
    }
    joints = config.groups["left"].joints
    assert listed["left"].commands == listed["left_PidGravity"].references
    assert listed["left_PidGravity"].commands == tuple(f"{joint}/effort" for joint in joints)
    assert listed["right"].commands == listed["right_ComputedTorque"].references
    assert listed["left_PidGravity"].type == GRAVITY


def test_no_two_active_controllers_write_to_one_interface(controllers):
    claimed = [name for c in controllers(State.MOTION, State.MOTION) if c.active for name in c.commands]
    assert len(claimed) == len(set(claimed))


def test_nothing_is_active_while_mcs_is_unconfigured(config):
    assert not [controller for controller in listed_controllers(config, {}, {}) if controller.active]


@pytest.mark.parametrize(
    ("left", "activate", "deactivate", "strictness", "steps"),
    [
        (State.COLD, ["left"], [], STRICT, [READY]),
        (State.MOTION, [], ["left"], STRICT, [REST]),
        (State.MOTION, ["right"], ["left"], STRICT, [REST, SwitchStep(SwitchAction.READY, "right")]),
        (State.MOTION, ["left_ComputedTorque"], ["left_PidGravity"], STRICT, [law(TORQUE)]),
        (State.MOTION, ["left_ComputedTorque"], [], FORCE_AUTO, [law(TORQUE)]),
        (State.MOTION, ["left_ComputedTorque"], [], AUTO, [law(TORQUE)]),
        (State.COLD, ["left", "left_ComputedTorque"], [], STRICT, [READY, law(TORQUE)]),
        (State.MOTION, [], ["left", "left_PidGravity"], STRICT, [REST]),
        (State.MOTION, ["left"], [], BEST_EFFORT, []),
        (State.MOTION, ["left"], [], 0, []),
        (State.MOTION, ["hat", "right"], [], BEST_EFFORT, [SwitchStep(SwitchAction.READY, "right")]),
        (State.MOTION, [], [], STRICT, []),
    ],
)
def test_a_switch_is_steps_of_groups(controllers, left, activate, deactivate, strictness, steps):
    assert switch_steps(controllers(left), activate, deactivate, strictness) == steps


@pytest.mark.parametrize(
    ("activate", "deactivate", "strictness", "kind", "message"),
    [
        (["hat", "right"], [], STRICT, NotFoundError, "controller 'hat'"),
        (["hat"], [], BEST_EFFORT, NotFoundError, "controller 'hat'"),
        (["left"], [], STRICT, StateError, "left is active already"),
        ([], ["right"], STRICT, StateError, "right is inactive already"),
        (["left"], ["left"], BEST_EFFORT, StateError, "left: to be activated and deactivated at once"),
        ([], ["left_gripper"], STRICT, StateError, "left_gripper is not switched"),
        ([], ["left_PidGravity"], BEST_EFFORT, StateError, "needs a law; activate another one"),
        (["left_Pid", "left_ComputedTorque"], ["left_PidGravity"], STRICT, StateError, "another law of group 'left'"),
        (["left_Pid"], [], STRICT, StateError, "left_Pid needs what left_PidGravity has"),
        (["right_Pid"], [], FORCE_AUTO, StateError, "activate right in the same call"),
        (["left_Pid"], ["left"], FORCE_AUTO, StateError, "activate left in the same call"),
    ],
)
def test_what_cannot_be_switched_is_said_before_anything_is(
    controllers, activate, deactivate, strictness, kind, message
):
    with pytest.raises(kind, match=message):
        switch_steps(controllers(), activate, deactivate, strictness)
