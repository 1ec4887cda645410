"""``/controller_manager/...``: groups, laws and hardware as tools of ros2_control look for them."""

from collections.abc import Iterable

from controller_manager_msgs.msg import ChainConnection, ControllerState, HardwareComponentState, HardwareInterface
from controller_manager_msgs.srv import (
    ListControllers,
    ListHardwareComponents,
    ListHardwareInterfaces,
    SwitchController,
)
from lifecycle_msgs.msg import State as LifecycleState

from im_mcs.client.controllers import MEASURED, ListedController, SwitchAction, listed_controllers, switch_steps
from im_mcs.limits.slots import Slot
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.services import StateServices, offer, switch_law
from im_mcs.state import Event

_PREFIX = "/controller_manager"
_WRENCH = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
_STATES = {"joint": MEASURED, "gripper": MEASURED, "wrench": _WRENCH}
_LABELS = {
    LifecycleState.PRIMARY_STATE_UNCONFIGURED: "unconfigured",
    LifecycleState.PRIMARY_STATE_INACTIVE: "inactive",
    LifecycleState.PRIMARY_STATE_ACTIVE: "active",
}


class ControllerServices:
    """``list_controllers``, ``list_hardware_components``, ``list_hardware_interfaces`` and ``switch_controller``.

    Args:
        access: MCS.
        services: Those of the state manager, which make a group ready.
    """

    def __init__(self, access: McsAccess, services: StateServices) -> None:
        self._mcs, self._services = access, services
        offer(access, ListControllers, f"{_PREFIX}/list_controllers", self._list_controllers)
        offer(access, ListHardwareComponents, f"{_PREFIX}/list_hardware_components", self._list_components)
        offer(access, ListHardwareInterfaces, f"{_PREFIX}/list_hardware_interfaces", self._list_interfaces)
        offer(access, SwitchController, f"{_PREFIX}/switch_controller", self._switch)

    def _controllers(self) -> list[ListedController]:
        if not self._mcs.keeper.running:
            return listed_controllers(self._mcs.config, {}, {})
        snapshot = self._mcs.client().snapshot()
        return listed_controllers(self._mcs.config, messages.states(snapshot), messages.laws(snapshot))

    async def _list_controllers(self, _: object, response: ListControllers.Response, __: str) -> str:
        rate = round(1.0 / self._mcs.config.servo.period_s)
        controllers, configured = self._controllers(), self._mcs.keeper.running
        laws = {controller.references: controller for controller in controllers if controller.law}
        response.controller = [
            ControllerState(
                name=each.name,
                state="active" if each.active else "inactive" if configured else "unconfigured",
                type=each.type,
                update_rate=rate,
                claimed_interfaces=each.commands if each.active else [],
                required_command_interfaces=each.commands,
                required_state_interfaces=each.states,
                is_chainable=bool(each.law),
                is_chained=bool(each.law) and each.active,
                reference_interfaces=each.references,
                chain_connections=[
                    ChainConnection(name=law.name, reference_interfaces=each.commands)
                    for law in (laws.get(each.commands),)
                    if law is not None
                ],
            )
            for each in controllers
        ]
        return ""

    async def _list_components(self, _: object, response: ListHardwareComponents.Response, __: str) -> str:
        config = self._mcs.config
        state = LifecycleState.PRIMARY_STATE_UNCONFIGURED
        if self._mcs.keeper.running:
            powered = bool(self._mcs.client().snapshot()["power"])
            state = LifecycleState.PRIMARY_STATE_ACTIVE if powered else LifecycleState.PRIMARY_STATE_INACTIVE
        for name, driver in config.testbed.drivers.items():
            slots = [slot for slot in config.slots if slot.driver == name]
            response.component.append(
                HardwareComponentState(
                    name=name,
                    type="system",
                    rw_rate=round(1.0 / config.servo.period_s),
                    class_type=driver.driver,
                    plugin_name=driver.driver,
                    state=LifecycleState(id=state, label=_LABELS[state]),
                    command_interfaces=self._commands(slots),
                    state_interfaces=self._states(slots),
                )
            )
        return ""

    async def _list_interfaces(self, _: object, response: ListHardwareInterfaces.Response, __: str) -> str:
        slots = self._mcs.config.slots
        response.command_interfaces, response.state_interfaces = self._commands(slots), self._states(slots)
        return ""

    def _commands(self, slots: Iterable[Slot]) -> list[HardwareInterface]:
        claimed = {name for each in self._controllers() if each.active for name in each.commands}
        taken = {slot.name: "position" if slot.kind == "gripper" else slot.interface for slot in slots}
        names = [f"{slot.name}/{taken[slot.name]}" for slot in slots if slot.kind != "wrench"]
        there = self._there()
        return [HardwareInterface(name=name, is_available=there, is_claimed=name in claimed) for name in names]

    def _states(self, slots: Iterable[Slot]) -> list[HardwareInterface]:
        there = self._there()
        names = [f"{slot.name}/{quantity}" for slot in slots for quantity in _STATES[slot.kind]]
        return [HardwareInterface(name=name, is_available=there) for name in names]

    def _there(self) -> bool:
        """Whether the hardware answers."""
        return self._mcs.keeper.running and bool(self._mcs.client().snapshot()["linked"])

    async def _switch(self, request: SwitchController.Request, _: object, client: str) -> str:
        self._mcs.client()
        names = list(request.activate_controllers), list(request.deactivate_controllers)
        done = []
        for step in switch_steps(self._controllers(), *names, request.strictness):
            if step.action is SwitchAction.REST:
                done.append(await self._mcs.transition(Event.DISABLE_MOTION, client, step.group))
            elif step.action is SwitchAction.READY:
                done.append(await self._services.make_ready(step.group, client))
            else:
                done.append(await switch_law(self._mcs, step.group, step.law, client))
        return "; ".join(done) or "nothing was to be switched"
