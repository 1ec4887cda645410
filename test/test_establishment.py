"""What a command has established goes with the incarnation of who keeps it, also where a coordinator has just begun."""

import asyncio

import pytest
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_coordinators.ros import establishment
from im_coordinators.ros.establishment import Establishment
from im_coordinators.ros.gripper import gripper_functions
from im_coordinators.ros.motion import motion_functions
from im_coordinators.ros.path_planning import planning_functions
from im_coordinators.ros.vision import vision_functions
from im_core.errors import DataError, StateError, WaitTimeoutError
from im_dispatcher.command import joined
from im_dispatcher.commands import installed
from im_dispatcher.report import StepTimes
from im_pnt.model.action import FunctionAction
from im_pnt_node.ros.rerun import installed_nets


class Objects(dict):
    """The objects of a DOM."""

    async def put(self, name, message):
        self[name] = message

    async def get(self, name, message_type):
        return self[name]

    async def is_valid(self, name):
        return name in self


class Coordinator:
    """One that hears the tasks with the given lives, the next one after each pause."""

    def __init__(self, *lives):
        self.name, self.dom, self._lives = "/coordinator", Objects(), list(lives)

    def incarnation(self, task):
        return self._lives[0]

    async def pause(self, seconds):
        if len(self._lives) > 1:
            self._lives.pop(0)


class Command:
    """The context of an action of a command."""

    def __init__(self, **arguments):
        self.request_arguments, self.memory = arguments, {}

    def object(self, name):
        return f"1/{name}"


def dispatched(host):
    return joined(command.functions(host, StepTimes()) for command in installed())


@pytest.mark.parametrize("heard", [(5,), (None, None, 5)], ids=["known", "just begun"])
def test_another_life_is_noticed_whenever_the_coordinator_began(heard):
    host = Coordinator(*heard, 6)
    powered = Establishment(host, "mcs", "powered")

    async def mission():
        await powered.note(Command(), "left")
        await powered.require(Command(), "left")
        await host.pause(1.0)
        with pytest.raises(StateError, match="mcs has begun anew since left was powered") as raised:
            await powered.require(Command(), "left")
        assert raised.value.code == "begun_anew"

    asyncio.run(mission())


def test_what_was_reserved_in_a_life_that_was_not_heard_of_yet_is_established_when_the_arm_is_found_held():
    host = Coordinator(5, 6)
    actions = motion_functions(host).actions
    command = Command(group="left")

    async def mission():
        await actions["to_reserve"](command)  # the new incarnation answers, of which the coordinator has not heard
        await host.pause(1.0)
        with pytest.raises(StateError, match="begun anew"):
            await actions["while_reserved"](command)
        await actions["note_held"](command)
        await actions["while_reserved"](command)

    asyncio.run(mission())


def test_a_move_in_doubt_is_planned_to_where_it_was_to_lead_and_not_as_far_again_from_where_the_arm_is():
    """A coordinator that was away for longer than /mcs keeps results cannot know that the arm is there already."""
    host = Coordinator(1)
    made = motion_functions(host).actions
    asked = {"group": "left", "destination": "", "position": [0.0, 0.0, 0.1], "orientation": [], "frame": "tool"}
    command = Command(**asked, joints=[], path="", near="here", region=[], yaw=0.0, tilt=0.1)
    host.dom[command.object("path/left")] = JointTrajectory(points=[JointTrajectoryPoint(positions=[0.5, 1.5])])

    assert made["destination_asked"](command)["frame"] == "tool"
    asyncio.run(made["path_to_follow"](command))
    again = made["destination_asked"](command)
    assert again == {"group": "left", "near": "here", "tilt": 0.1, "leaves": "path/left", "joints": [0.5, 1.5]}


def test_a_tilt_goes_with_no_path_that_is_given_and_with_no_straight_line():
    made = motion_functions(Coordinator(1)).actions
    asked = {
        "group": "left",
        "destination": "",
        "position": [],
        "joints": [],
        "path": "given",
        "region": [],
        "yaw": 0.0,
    }
    with pytest.raises(DataError, match="argument tilt goes with a path that is planned; it was given with path"):
        made["path_asked"](Command(**asked, tilt=0.1))
    with pytest.raises(DataError, match="argument tilt goes with a path that is planned; it was given with straight"):
        asyncio.run(made["straight_line"](Command(**asked, tilt=0.1)))


@pytest.mark.parametrize(
    "functions",
    [motion_functions, gripper_functions, planning_functions, vision_functions, dispatched],
    ids=["motion", "gripper", "planning", "vision", "dispatcher"],
)
def test_of_every_action_it_can_be_found_out_what_became_of_it(functions):
    """A node that lost its life, and the end of its journal, asks; who cannot be asked ends the command."""
    done = {
        transition.action.function
        for net in installed_nets().values()
        for transition in net.transitions.values()
        if isinstance(transition.action, FunctionAction) and not transition.on_doubt
    }
    made = functions(Coordinator(1))
    assert not (done & set(made.actions)) - set(made.asks)


def test_nothing_is_established_at_one_who_is_not_heard(monkeypatch):
    monkeypatch.setattr(establishment, "HEARD_S", 0.0)
    host = Coordinator(None)
    with pytest.raises(WaitTimeoutError, match="the heartbeat of mcs"):
        asyncio.run(Establishment(host, "mcs", "powered").note(Command(), "left"))
    assert not host.dom
