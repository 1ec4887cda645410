"""The interfaces of control_msgs and controller_manager_msgs as in Jazzy: all are there, with the hashes of Jazzy's.

The definitions below are the fields of Jazzy's (ros-controls), written down apart
from the files of ``ros_ws/standard_msgs``; ``rosbags`` computes RIHS01 from them with code of its own, and with its own
definitions of everything that they contain. The hashes that the built packages carry, computed by rosidl, must be the
same: else no peer of a standard Jazzy would talk to us. Of the service, which ``rosbags`` names otherwise, the fields
are compared.
"""

import json
from importlib import import_module
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from control_msgs.action import FollowJointTrajectory
from control_msgs.srv import QueryTrajectoryState
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

JAZZY = {
    "msg": {
        *("AdmittanceControllerState", "BatteryStateArray", "DynamicInterfaceGroupValues", "DynamicInterfaceValues"),
        *("DynamicJointState", "Float64Values", "GripperCommand", "InterfaceValue", "JointComponentTolerance"),
        *("JointControllerState", "JointJog", "JointTolerance", "JointTrajectoryControllerState", "Keys"),
        *("MecanumDriveControllerState", "MotionArgument", "MotionPrimitive", "MotionPrimitiveSequence"),
        *("MultiDOFCommand", "MultiDOFStateStamped", "PidState", "SingleDOFState", "SingleDOFStateStamped"),
        *("SpeedScalingFactor", "SteeringControllerStatus", "VDA5050SafetyState"),
    },
    "srv": {"QueryCalibrationState", "QueryTrajectoryState", "SetOdometry"},
    "action": {
        *("ExecuteMotionPrimitiveSequence", "FollowJointTrajectory", "GripperCommand", "JointTrajectory"),
        *("ParallelGripperCommand", "PointHead", "SingleJointPosition"),
    },
}
SERVICES_OF_MANAGER = {
    **dict.fromkeys(
        ("CleanupController", "ConfigureController", "LoadController", "UnloadController"),
        ({"name": "string"}, {"ok": "boolean"}),
    ),
    "ListControllerTypes": ({}, {"types": "sequence<string>", "base_classes": "sequence<string>"}),
    "ListControllers": ({}, {"controller": "sequence<controller_manager_msgs/ControllerState>"}),
    "ListHardwareComponents": ({}, {"component": "sequence<controller_manager_msgs/HardwareComponentState>"}),
    "ListHardwareInterfaces": (
        {},
        {
            "command_interfaces": "sequence<controller_manager_msgs/HardwareInterface>",
            "state_interfaces": "sequence<controller_manager_msgs/HardwareInterface>",
        },
    ),
    "ReloadControllerLibraries": ({"force_kill": "boolean"}, {"ok": "boolean"}),
    "SetHardwareComponentState": (
        {"name": "string", "target_state": "lifecycle_msgs/State"},
        {"ok": "boolean", "state": "lifecycle_msgs/State"},
    ),
    "SwitchController": (
        {
            "activate_controllers": "sequence<string>",
            "deactivate_controllers": "sequence<string>",
            "strictness": "int32",
            "activate_asap": "boolean",
            "timeout": "builtin_interfaces/Duration",
        },
        {"ok": "boolean", "message": "string"},
    ),
}
"""Fields of request and answer of every service of controller_manager_msgs 4.45.0."""
ACTIONS = ("FollowJointTrajectory", "GripperCommand", "ParallelGripperCommand")
MESSAGES = ("JointTrajectoryControllerState", "DynamicJointState", "SpeedScalingFactor", "JointJog")
DEFINITIONS = {
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n",
    "control_msgs/msg/JointComponentTolerance": """
uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
""",
    "control_msgs/msg/JointTrajectoryControllerState": """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output
float64 speed_scaling_factor
""",
    "control_msgs/action/FollowJointTrajectory_Goal": """
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointComponentTolerance[] component_path_tolerance
control_msgs/JointTolerance[] goal_tolerance
control_msgs/JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
""",
    "control_msgs/action/FollowJointTrajectory_Result": """
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
int32 error_code
string error_string
""",
    "control_msgs/action/FollowJointTrajectory_Feedback": """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
""",
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort\n",
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    ),
    "control_msgs/msg/SpeedScalingFactor": "float64 factor\n",
    "control_msgs/msg/JointJog": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "float64[] displacements\nfloat64[] velocities\nfloat64 duration\n"
    ),
    "controller_manager_msgs/msg/ChainConnection": "string name\nstring[] reference_interfaces\n",
    "controller_manager_msgs/msg/ControllerState": """
string name
string state
string type
bool is_async
uint16 update_rate
string[] claimed_interfaces
string[] required_command_interfaces
string[] required_state_interfaces
bool is_chainable
bool is_chained
string[] exported_state_interfaces
string[] reference_interfaces
controller_manager_msgs/ChainConnection[] chain_connections
""",
    "controller_manager_msgs/msg/HardwareInterface": "string name\nbool is_available\nbool is_claimed\n",
    "controller_manager_msgs/msg/HardwareComponentState": """
string name
string type
bool is_async
uint16 rw_rate
string class_type
string plugin_name
lifecycle_msgs/State state
controller_manager_msgs/HardwareInterface[] command_interfaces
controller_manager_msgs/HardwareInterface[] state_interfaces
""",
    "controller_manager_msgs/msg/NamedLifecycleState": "string name\nlifecycle_msgs/State state\n",
    "controller_manager_msgs/msg/ControllerManagerActivity": """
std_msgs/Header header
controller_manager_msgs/NamedLifecycleState[] controllers
controller_manager_msgs/NamedLifecycleState[] hardware_components
""",
    "control_msgs/action/ParallelGripperCommand_Goal": "sensor_msgs/JointState command\n",
    "control_msgs/action/ParallelGripperCommand_Result": (
        "sensor_msgs/JointState state\nbool stalled\nbool reached_goal\n"
    ),
    "control_msgs/action/ParallelGripperCommand_Feedback": "sensor_msgs/JointState state\n",
    "control_msgs/action/GripperCommand_Goal": "control_msgs/GripperCommand command\n",
    "control_msgs/action/GripperCommand_Result": (
        "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal\n"
    ),
    "control_msgs/action/GripperCommand_Feedback": (
        "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal\n"
    ),
}


@pytest.fixture(scope="module")
def store():
    types = get_typestore(Stores.ROS2_JAZZY)
    # rosidl makes uint8 of the char in service_msgs (char is a deprecated alias of it); rosbags keeps char.
    event = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number\n"
    types.fielddefs.update(get_types_from_msg(event, "service_msgs/msg/ServiceEventInfo"))
    definitions = dict(DEFINITIONS)
    for action in ACTIONS:
        definitions |= _with_services(f"control_msgs/action/{action}")
    for name, text in definitions.items():
        types.register(get_types_from_msg(text, name))
    return types


def _with_services(action: str) -> dict[str, str]:
    """What rosidl makes of an action beside its goal, result and feedback."""
    parts = {
        f"{action}_SendGoal_Request": f"unique_identifier_msgs/UUID goal_id\n{action}_Goal goal\n",
        f"{action}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
        f"{action}_GetResult_Request": "unique_identifier_msgs/UUID goal_id\n",
        f"{action}_GetResult_Response": f"int8 status\n{action}_Result result\n",
        f"{action}_FeedbackMessage": f"unique_identifier_msgs/UUID goal_id\n{action}_Feedback feedback\n",
    }
    for service in ("SendGoal", "GetResult"):
        name = f"{action}_{service}"
        parts[f"{name}_Event"] = (
            f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response\n"
        )
        parts[name] = f"{name}_Request request_message\n{name}_Response response_message\n{name}_Event event_message\n"
    parts[action] = (
        f"{action}_Goal goal\n{action}_Result result\n{action}_Feedback feedback\n"
        f"{action}_SendGoal send_goal_service\n{action}_GetResult get_result_service\n"
        f"{action}_FeedbackMessage feedback_message\n"
    )
    return parts


def _built_hashes(name, kind="action", package="control_msgs"):
    """Type hashes in the built package, by type name."""
    folder = Path(get_package_share_directory(package))
    described = json.loads((folder / kind / f"{name}.json").read_text(encoding="utf-8"))
    return {entry["type_name"]: entry["hash_string"] for entry in described["type_hashes"]}


@pytest.mark.parametrize("kind", JAZZY)
def test_every_interface_of_jazzy_is_there_and_no_other(kind):
    folder = Path(get_package_share_directory("control_msgs")) / kind
    assert {path.stem for path in folder.glob(f"*.{kind}")} == JAZZY[kind]
    module = import_module(f"control_msgs.{kind}")
    assert all(hasattr(module, name) for name in JAZZY[kind])


@pytest.mark.parametrize("action", ACTIONS)
def test_type_hashes_are_those_of_jazzy(store, action):
    built = _built_hashes(action)
    ours = [name for name in built if name.startswith("control_msgs/")]
    assert len(ours) >= 13
    for name in ours:
        assert built[name] == store.hash_rihs01(name), name


@pytest.mark.parametrize("name", MESSAGES)
def test_the_type_hashes_of_messages_are_those_of_jazzy(store, name):
    full = f"control_msgs/msg/{name}"
    assert _built_hashes(name, "msg")[full] == store.hash_rihs01(full)


def test_the_messages_of_the_controller_manager_are_those_of_jazzy(store):
    package = "controller_manager_msgs"
    folder = Path(get_package_share_directory(package)) / "msg"
    given = {name.rpartition("/")[2] for name in DEFINITIONS if name.startswith(f"{package}/")}
    assert {path.stem for path in folder.glob("*.msg")} == given
    for name in given:
        full = f"{package}/msg/{name}"
        assert _built_hashes(name, "msg", package)[full] == store.hash_rihs01(full), name


def test_the_services_of_the_controller_manager_have_the_fields_of_jazzy():
    folder = Path(get_package_share_directory("controller_manager_msgs")) / "srv"
    assert {path.stem for path in folder.glob("*.srv")} == SERVICES_OF_MANAGER.keys()
    module = import_module("controller_manager_msgs.srv")
    for name, fields in SERVICES_OF_MANAGER.items():
        kind = getattr(module, name)
        assert (kind.Request.get_fields_and_field_types(), kind.Response.get_fields_and_field_types()) == fields


def test_the_query_of_a_trajectory_has_the_fields_of_jazzy():
    assert QueryTrajectoryState.Request.get_fields_and_field_types() == {"time": "builtin_interfaces/Time"}
    assert QueryTrajectoryState.Response.get_fields_and_field_types() == {
        "success": "boolean",
        "message": "string",
        "name": "sequence<string>",
        "position": "sequence<double>",
        "velocity": "sequence<double>",
        "acceleration": "sequence<double>",
    }


def test_the_hash_of_the_action_is_on_the_wire(store):
    """The type support that rclpy loads is the one whose description was read."""
    goal = FollowJointTrajectory.Goal()
    assert list(goal.get_fields_and_field_types()) == [
        line.split()[1] for line in DEFINITIONS["control_msgs/action/FollowJointTrajectory_Goal"].strip().splitlines()
    ]


def test_a_different_definition_has_a_different_hash(store):
    """The field that later branches add to the feedback is not in Jazzy's."""
    name = "control_msgs/action/FollowJointTrajectory_Feedback"
    other = get_typestore(Stores.ROS2_JAZZY)
    other.register(get_types_from_msg(DEFINITIONS[name] + "int32 index\n", name))
    assert other.hash_rihs01(name) != store.hash_rihs01(name)
