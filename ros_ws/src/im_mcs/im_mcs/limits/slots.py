"""Channel drivers and slots of ``mcs.yaml``."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from im_cell.robot import Cell
from im_core import plugins
from im_core.config import FieldError, Model
from im_core.errors import ConfigError

Kind = Literal["joint", "gripper", "wrench"]

Interface = Literal["effort", "velocity", "position"]
"""Kind of the commands that a joint takes, by the names of ros2_control."""

LAW_METHODS: dict[Interface, str] = {"effort": "torque", "velocity": "velocity", "position": "position"}
"""Method of a control law for each kind; the first one of a law counts."""

OFFERED = ("instance", "timeout_s", "interfaces")
"""Parameters of a driver's constructor that MCS fills in."""


class Driver(Model):
    """Channel driver and the settings, the keywords of the constructor."""

    driver: str = Field(pattern=r"^[\w.]+:\w+$")
    settings: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _loadable(self) -> Self:
        try:
            check_settings(self.driver, self.settings)
        except ConfigError as error:
            raise ValueError(error.message) from None
        return self


class Testbed(Model):
    """Where the channels are."""

    __test__ = False  # not a test class, whatever pytest thinks of the name

    drivers: dict[str, Driver] = Field(min_length=1)
    clock: str = Field(description="driver with the ticks of the servo")

    @model_validator(mode="after")
    def _clock_exists(self) -> Self:
        if self.clock not in self.drivers:
            raise ValueError(f"clock '{self.clock}' is not one of the drivers {', '.join(sorted(self.drivers))}")
        return self


class SlotLimits(Model):
    """Limits of one slot, narrower than the cell's; missing ones are the cell's.

    ``JointLimits`` takes, for every joint slot, the narrower of these and of its share of the cell's.
    """

    lower: float | None = Field(default=None, description="[rad or m]")
    upper: float | None = Field(default=None, description="[rad or m]")
    velocity: float | None = Field(default=None, gt=0, description="[rad/s or m/s]")
    torque: float | None = Field(default=None, gt=0, description="[Nm or N]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError(f"lower {self.lower} is not < upper {self.upper}")
        return self


class Slot(Model):
    """Joint, gripper or wrist force-torque sensor, and the channel."""

    name: str = Field(min_length=1)
    kind: Kind = "joint"
    driver: str
    channel: int = Field(ge=0)
    interface: Interface = Field(default="effort", description="what commands of a joint are")
    limits: SlotLimits | None = None

    @model_validator(mode="after")
    def _limited(self) -> Self:
        if self.limits is not None and self.kind != "joint":
            raise ValueError(f"slot '{self.name}' is a {self.kind}; only joints have limits of their own")
        if self.interface != "effort" and self.kind != "joint":
            raise ValueError(f"slot '{self.name}' is a {self.kind}; only joints have an interface")
        return self


def slots_of(cell: Cell, driver: str) -> tuple[Slot, ...]:
    """Return slots for all that a cell has, on the channels of one driver in the cell's order."""
    named: dict[Kind, Iterable[str]] = {
        "joint": cell.joint_names, "gripper": cell.devices("gripper"), "wrench": cell.devices("force")
    }  # fmt: skip
    return tuple(
        Slot(name=name, kind=kind, driver=driver, channel=channel)
        for kind, names in named.items()
        for channel, name in enumerate(names)
    )


def check_slots(testbed: Testbed, slots: tuple[Slot, ...]) -> None:
    """Refuse slots with contradictions or with an unknown driver.

    Raises:
        FieldError: With slot, driver, channel, and what exists.
    """
    names: set[str] = set()
    served: dict[tuple[str, str, int], str] = {}
    for rank, slot in enumerate(slots):
        if slot.name in names:
            raise FieldError(("slots", rank, "name"), f"two slots have the same name, '{slot.name}'")
        names.add(slot.name)
        if slot.driver not in testbed.drivers:
            known = ", ".join(sorted(testbed.drivers))
            where = ("slots", rank, "driver")
            raise FieldError(where, f"slot '{slot.name}': there is no driver '{slot.driver}' (known: {known})")
        channel = (slot.driver, slot.kind, slot.channel)
        if channel in served:
            raise FieldError(
                ("slots", rank, "channel"),
                f"slot '{slot.name}': {slot.kind} channel {slot.channel} of driver '{slot.driver}' already serves"
                f" slot '{served[channel]}'",
            )
        served[channel] = slot.name
        takes = getattr(find_driver(testbed.drivers[slot.driver].driver), "interfaces_taken", ("effort",))
        if slot.kind == "joint" and slot.interface not in takes:
            raise FieldError(
                ("slots", rank, "interface"),
                f"slot '{slot.name}': driver '{slot.driver}' takes {' or '.join(takes)}, not {slot.interface}",
            )


def interface_of(law: str) -> Interface:
    """Return the kind of commands of the control law ``module:Class``: that of its method.

    A law that cannot be loaded counts as one of torques; what makes it says why it cannot be.
    """
    try:
        return _interface_of(law)
    except ConfigError:
        return "effort"


@cache
def _interface_of(law: str) -> Interface:
    found = plugins.load(law, None, "controller")
    return next((kind for kind, method in LAW_METHODS.items() if hasattr(found, method)), "effort")


def check_settings(name: str, settings: Mapping[str, object]) -> None:
    """Check the existence of a driver ``module:Class`` with the given settings.

    Raises:
        ConfigError: There is none, or it does not take them; says what it takes.
    """
    signature = inspect.signature(find_driver(name))
    parameters = {key: given for key, given in signature.parameters.items() if key not in OFFERED}
    takes = f"channel driver '{name}' takes {', '.join(parameters) or 'no settings'}"
    for key in settings:
        if key not in parameters:
            raise ConfigError(f"there is no setting '{key}'; {takes}", driver=name, setting=key)
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and key not in settings:
            raise ConfigError(f"the setting '{key}' is missing; {takes}", driver=name, setting=key)


def find_driver(name: str) -> Callable[..., object]:
    """Return the class of a channel driver by the name ``module:Class``.

    Raises:
        ConfigError: There is no such module or class.
    """
    found = plugins.load(name, None, "channel driver")
    if not callable(found):
        raise ConfigError(f"channel driver '{name}' is no class", driver=name)
    return found
