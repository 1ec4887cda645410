"""Groups, control laws and grippers in the form of controllers of ros2_control: a list, and the steps of a switch.

A group is a joint trajectory controller, chained to the control law in force, which writes commands. The group is
active while it may move; a law is active while it is in force and the group is active.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from im_core.errors import ImError, NotFoundError, StateError
from im_mcs.limits.configuration import McsConfig
from im_mcs.state.table import POWERED, State

BEST_EFFORT, STRICT, AUTO, FORCE_AUTO = 1, 2, 3, 4
"""Strictness of a switch, as ``controller_manager_msgs/SwitchController`` numbers it; 0 stands for best effort."""

_GROUP = "joint_trajectory_controller/JointTrajectoryController"
_GRIPPER = "position_controllers/GripperActionController"
_BROADCASTER = "joint_state_broadcaster/JointStateBroadcaster"
MEASURED = ("position", "velocity", "effort")
"""State interfaces of a joint or a gripper."""


@dataclass(frozen=True)
class ListedController:
    """Part of MCS as a controller.

    Attributes:
        name: As ros2_control would know it.
        type: Class of the controller; of a law its ``module:Class``.
        active: Whether it is active.
        commands: Command interfaces that it writes to: of hardware, or of the law in force.
        states: State interfaces that it reads.
        group: Its group; empty: of a gripper, or the broadcaster.
        law: The law; empty: none.
        references: Interfaces of a law that its group writes to.
    """

    name: str
    type: str
    active: bool
    commands: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
    group: str = ""
    law: str = ""
    references: tuple[str, ...] = ()


class SwitchAction(StrEnum):
    """What a step of a switch does to a group."""

    REST = "rest"
    READY = "ready"
    LAW = "law"


@dataclass(frozen=True)
class SwitchStep:
    """Step of a switch."""

    action: SwitchAction
    group: str
    law: str = ""


def listed_controllers(
    config: McsConfig, states: Mapping[str, State], laws: Mapping[str, str]
) -> list[ListedController]:
    """Return the controllers of the preset in force.

    Args:
        config: Configuration.
        states: State of each group; empty: MCS is unconfigured.
        laws: Law in force of each group.
    """
    interfaces = {slot.name: slot.interface for slot in config.joint_slots}
    joints = list(interfaces)
    measured = tuple(f"{joint}/{quantity}" for joint in joints for quantity in MEASURED)
    controllers = [ListedController("joint_state_broadcaster", _BROADCASTER, bool(states), states=measured)]
    for group, description in config.groups.items():
        active = states.get(group) is State.MOTION
        state = tuple(f"{joint}/{quantity}" for joint in description.joints for quantity in MEASURED)
        commands = tuple(f"{joint}/{interfaces[joint]}" for joint in description.joints)
        in_force = laws.get(group, config.control_of(group).controller)
        for law in config.parameters_of_laws(group):
            name = f"{group}_{law.rpartition(':')[2]}"
            references = tuple(f"{name}/{joint}/position" for joint in description.joints)
            in_use = active and law == in_force
            controllers.append(ListedController(name, law, in_use, commands, state, group, law, references))
            if law == in_force:
                controllers.append(ListedController(group, _GROUP, active, references, state, group))
    powered = any(state in POWERED for state in states.values())
    for slot in config.gripper_slots:
        jaws = (f"{slot.name}/position",)
        controllers.append(ListedController(slot.name, _GRIPPER, powered, jaws, jaws))
    return controllers


def switch_steps(
    controllers: Sequence[ListedController], activate: Sequence[str], deactivate: Sequence[str], strictness: int
) -> list[SwitchStep]:
    """Return the steps of a switch, checked as a whole before the first.

    What cannot be switched is an error, or passed over with best effort, unless nothing of a list is left.

    Args:
        controllers: All there are.
        activate: Names of controllers that shall be active.
        deactivate: Names of those that shall not.
        strictness: One of the four, or 0.

    Raises:
        NotFoundError: There is no such controller.
        StateError: One is in both lists, cannot be switched, or is as asked for already; or a group would have no law,
            or two.
    """
    by_name = {controller.name: controller for controller in controllers}
    if both := sorted({*activate} & {*deactivate}):
        raise StateError(f"{', '.join(both)}: to be activated and deactivated at once")
    stops, starts = (
        _switchable(by_name, names, wanted, strict=strictness == STRICT)
        for names, wanted in ((deactivate, False), (activate, True))
    )
    rest = {controller.group for controller in stops if not controller.law}
    ready = {controller.group for controller in starts if not controller.law}
    laws = {controller.group: controller.law for controller in starts if controller.law}
    freed = {controller.group for controller in stops if controller.law}
    in_force = {c.group: c.name for c in controllers if c.law and c.active}
    for group in freed - laws.keys() - rest:
        raise StateError(f"{in_force[group]}: group '{group}' needs a law; activate another one in the same call")
    for controller in (controller for controller in starts if controller.law):
        group = controller.group
        if laws[group] != controller.law:
            raise StateError(f"{controller.name}: another law of group '{group}' is to be activated, too")
        if group in rest or (group not in in_force and group not in ready):
            raise StateError(f"{controller.name} is active only with its group: activate {group} in the same call")
        if group in in_force and group not in freed and strictness not in (AUTO, FORCE_AUTO):
            raise StateError(f"{controller.name} needs what {in_force[group]} has: deactivate that in the same call")
    return [
        *(SwitchStep(SwitchAction.REST, group) for group in sorted(rest)),
        *(SwitchStep(SwitchAction.READY, group) for group in sorted(ready)),
        *(SwitchStep(SwitchAction.LAW, group, law) for group, law in sorted(laws.items())),
    ]


def _switchable(
    by_name: Mapping[str, ListedController], names: Sequence[str], wanted: bool, *, strict: bool
) -> list[ListedController]:
    """Return the controllers that can be switched to the wanted state."""
    found, faults = list[ListedController](), list[ImError]()
    for name in dict.fromkeys(names):
        controller = by_name.get(name)
        if controller is None:
            faults.append(NotFoundError(kind="controller", name=name, known=by_name))
        elif controller.active is wanted:
            if strict:
                raise StateError(f"{name} is {'active' if wanted else 'inactive'} already")
        elif not controller.group:
            faults.append(StateError(f"{name} is not switched: it is active while MCS is configured or has power"))
        else:
            found.append(controller)
    if faults and (strict or len(faults) == len(set(names))):
        raise faults[0]
    return found
