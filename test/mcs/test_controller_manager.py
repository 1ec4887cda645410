"""What tools of ros2_control find: lists of controllers and hardware, and a switch, as MoveIt asks for them."""

import pytest
from controller_manager_msgs.srv import (
    ListControllers,
    ListHardwareComponents,
    ListHardwareInterfaces,
    SwitchController,
)

STRICT = SwitchController.Request.STRICT
MOVEIT_KNOWS = {
    "joint_trajectory_controller/JointTrajectoryController": "follow_joint_trajectory",
    "position_controllers/GripperActionController": "gripper_cmd",
}
"""Types for which MoveIt has an action client, and the name of the action below that of the controller."""


def controllers(stranger):
    answer = stranger.call(ListControllers, "/controller_manager/list_controllers")
    return {controller.name: controller for controller in answer.controller}


def switch(stranger, activate=(), deactivate=(), strictness=STRICT):
    return stranger.call(
        SwitchController,
        "/controller_manager/switch_controller",
        activate_controllers=list(activate),
        deactivate_controllers=list(deactivate),
        strictness=strictness,
    )


def test_moveit_finds_controllers_joints_and_actions(ready, stranger):
    """As Ros2ControlManager reads the list: a chained controller has the interfaces of the one behind it."""
    listed = controllers(stranger)
    offered = {name for name, _ in stranger.get_topic_names_and_types()}
    found = {}
    for name, controller in listed.items():
        if controller.type in MOVEIT_KNOWS:
            assert len(controller.chain_connections) <= 1
            source = listed[controller.chain_connections[0].name] if controller.chain_connections else controller
            found[name] = [interface.partition("/")[0] for interface in source.required_command_interfaces]
            assert f"/{name}/{MOVEIT_KNOWS[controller.type]}/_action/status" in offered
    assert found["left"] == ready.joints
    assert found.keys() == {"left", "right", "left_gripper", "right_gripper"}
    assert found["left_gripper"] == ["left_gripper"]
    assert (listed["left"].state, listed["right"].state) == ("active", "inactive")
    assert not listed["right"].claimed_interfaces
    law = listed["left_PidGravity"]
    assert (law.state, law.is_chainable, law.is_chained) == ("active", True, True)
    assert list(law.claimed_interfaces) == [f"{joint}/effort" for joint in ready.joints]
    assert listed["joint_state_broadcaster"].state == "active"


def test_hardware_is_listed_with_what_is_claimed(ready, stranger):
    (component,) = stranger.call(ListHardwareComponents, "/controller_manager/list_hardware_components").component
    assert (component.name, component.type, component.state.label) == ("testbed", "system", "active")
    assert component.rw_rate == 222
    interfaces = stranger.call(ListHardwareInterfaces, "/controller_manager/list_hardware_interfaces")
    claimed = {each.name for each in interfaces.command_interfaces if each.is_claimed}
    assert claimed == {
        *(f"{joint}/effort" for joint in ready.joints),
        "left_gripper/position",
        "right_gripper/position",
    }
    assert all(each.is_available for each in interfaces.command_interfaces)
    states = {each.name for each in interfaces.state_interfaces}
    assert {"left_j1/position", "left_j1/effort", "left_gripper/velocity", "right_force/torque.z"} <= states
    assert list(component.command_interfaces) == list(interfaces.command_interfaces)


def test_a_group_is_activated_from_cold_and_deactivated(client, stranger):
    assert controllers(stranger)["left"].state == "inactive"
    answer = switch(stranger, activate=["left"])
    assert answer.ok, answer.message
    client.until(lambda: client.status().state == "motion")
    assert controllers(stranger)["left"].state == "active"
    answer = switch(stranger, deactivate=["left"])
    assert answer.ok, answer.message
    client.until(lambda: client.status().state == "active")
    assert controllers(stranger)["left"].state == "inactive"


def test_a_law_takes_over_by_a_switch(ready, stranger):
    answer = switch(stranger, ["left_ComputedTorque"], ["left_PidGravity"])
    assert answer.ok, answer.message
    listed = controllers(stranger)
    assert (listed["left_ComputedTorque"].state, listed["left_PidGravity"].state) == ("active", "inactive")
    assert listed["left"].chain_connections[0].name == "left_ComputedTorque"
    assert ready.move(ready.home + 0.02).success
    assert switch(stranger, ["left_PidGravity"], strictness=SwitchController.Request.FORCE_AUTO).ok


@pytest.mark.parametrize("strictness", [STRICT, SwitchController.Request.BEST_EFFORT])
def test_a_switch_that_cannot_be_changes_nothing(ready, stranger, strictness):
    before = controllers(stranger)
    answer = switch(stranger, activate=["hat"], strictness=strictness)
    assert (answer.ok, "controller 'hat'" in answer.message) == (False, True)
    assert controllers(stranger) == before


def test_lists_are_there_while_mcs_is_unconfigured(client, stranger):
    assert client.change("cleanup")
    try:
        assert {controller.state for controller in controllers(stranger).values()} == {"unconfigured"}
        (component,) = stranger.call(ListHardwareComponents, "/controller_manager/list_hardware_components").component
        assert component.state.label == "unconfigured"
        assert not any(interface.is_available for interface in component.command_interfaces)
        assert not switch(stranger, activate=["left"]).ok
    finally:
        assert client.change("configure")
