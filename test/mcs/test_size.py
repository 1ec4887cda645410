"""Size before work: whatever is too long or too large is refused at once, in a sentence, and nothing waits for it."""

import pytest
from control_msgs.action import GripperCommand
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Pose
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core.errors import DataError
from im_core.ros.messages.interfaces import interface_class
from im_mcs.limits.configuration import load_config
from im_mcs.ros.bounds import check_bounds
from im_msgs.action import Move
from im_msgs.msg import SetpointCommand, TorqueCommand
from im_msgs.srv import CheckPath, ForwardKinematics, InverseKinematics, ReserveGroup
from test.mcs.test_fuzz import SERVICES

LONG, LARGE, MANY = "x" * 2**20, 1e300, 1000
MOST_POINTS = load_config().planning.max_points
KINDS = (*SERVICES.values(), Move.Goal, GripperCommand.Goal, SetpointCommand, TorqueCommand)


def outsized(message, place=""):
    """``(field, message)``: for every text, number and list of a message, the message with that one too large."""
    for name, kind in message.get_fields_and_field_types().items():
        if kind.startswith("sequence<"):
            inner = kind[9:-1]
            item = interface_class(inner.replace("/", "/msg/"))() if "/" in inner else {"string": "x"}.get(inner, 0.0)
            yield from _with(message, name, place, [item] * MANY)
            yield from _with(message, name, place, [LONG] if inner == "string" else [LARGE] if "/" not in inner else [])
        elif kind in ("string", "double"):
            yield from _with(message, name, place, LONG if kind == "string" else LARGE)
        elif "/" in kind:
            yield from outsized(getattr(message, name), f"{place}{name}.")


def _with(message, name, place, value):
    before = getattr(message, name)
    setattr(message, name, value)
    if value != []:
        yield f"{place}{name}"
    setattr(message, name, before)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_field_has_a_bound(kind):
    message = kind.Request() if hasattr(kind, "Request") else kind()
    fields = list(message.get_fields_and_field_types())
    check_bounds(message, MOST_POINTS)
    for field in outsized(message):
        with pytest.raises(DataError) as caught:
            check_bounds(message, MOST_POINTS)
        assert caught.value.message.startswith(field)
        assert len(caught.value.message) < 120
    assert fields


@pytest.mark.parametrize("name", SERVICES)
def test_no_service_echoes_a_megabyte_or_works_on_it(client, name):
    fields = SERVICES[name].Request().get_fields_and_field_types()
    text, kind = next((f, kind) for f, kind in fields.items() if "string" in kind)
    listed = kind != "string"
    answer = client.call(SERVICES[name], name, **{text: [LONG] if listed else LONG})
    said = answer.status.message if hasattr(answer, "status") else answer.message
    assert not (answer.ok if hasattr(answer, "ok") else answer.success)
    assert said == f"{text}{'[0]' if listed else ''} has 1048576 characters, 256 are allowed"


def test_numbers_that_no_machine_has(client):
    for lease in (1e308, 1e300, 2e6):
        answer = client.call(ReserveGroup, "reserve", group="left", lease=lease)
        assert answer.message == f"lease is {lease:g}, not between -1e+06 and 1e+06"
    assert client.call(ReserveGroup, "reserve", group="left", lease=1e6).success  # the servo lives
    answer = client.call(ForwardKinematics, "forward_kinematics", group="left", q=[1e300] * 9)
    assert answer.status.message == "q[0] is 1e+300, not between -1e+06 and 1e+06"
    answer = client.call(ForwardKinematics, "forward_kinematics", group="left", q=[0.0] * 10**6)
    assert answer.status.message == "q has 1000000 values, 64 are allowed"
    far = Pose()
    far.position.x, far.orientation.w = 1e300, 1.0
    answer = client.call(InverseKinematics, "inverse_kinematics", group="left", wrist=far)
    assert answer.status.message == "wrist.position.x is 1e+300, not between -1e+06 and 1e+06"
    astray = [JointTrajectoryPoint(positions=[9e5] * 9), JointTrajectoryPoint(positions=client.home.tolist())]
    answer = client.call(CheckPath, "check_path", group="left", path=JointTrajectory(points=astray))
    assert "left_track: position of point 1 900000 m is beyond the limit" in answer.status.message
    many = [JointTrajectoryPoint()] * (MOST_POINTS + 1)
    answer = client.call(CheckPath, "check_path", group="left", path=JointTrajectory(points=many))
    assert answer.status.message == f"path.points has {MOST_POINTS + 1} values, {MOST_POINTS} are allowed"
    assert not client.call(ChangeState, "change_state", transition=Transition(label=LONG)).success


def test_goals_and_commands(ready):
    result = ready.move(ready.home, names=[LONG] * 9)
    assert result.status.message == "path.joint_names[0] has 1048576 characters, 256 are allowed"
    assert ready.move(ready.home, blend=1e300).status.message.startswith("blend is 1e+300, not between")
    assert not ready.act(GripperCommand, "/left_gripper/gripper_cmd", _grip(1e300))[1]().result.reached_goal
    topics = {"/left/command/setpoints": SetpointCommand, "/left/command/torques": TorqueCommand}
    diagnostics = ready.listen(DiagnosticArray, "/diagnostics")
    for topic, kind in topics.items():
        ready.talk(kind, topic).publish(kind(owner=LONG, lease=1.0))
        ready.until(lambda topic=topic: _refused(diagnostics, topic))


def _grip(opening):
    goal = GripperCommand.Goal()
    goal.command.position = opening
    return goal


def _refused(diagnostics, topic):
    return any(v.key == topic and int(v.value) > 0 for m in diagnostics for s in m.status for v in s.values)
