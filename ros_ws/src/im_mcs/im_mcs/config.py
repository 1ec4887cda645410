"""Configuration of MCS: ``config/mcs.yaml`` as frozen, checked models."""

from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from im_core.config import Model, load_model, package_file
from im_core.errors import NotFoundError
from im_mcs.planning.joint_path import Synchrony


class Settle(Model):
    """When a group counts as at rest."""

    tolerance: float = Field(gt=0, description="mean error of each joint [rad or m]")
    still_tolerance: float = Field(
        gt=0, description="the same for an arm that stands still after half of timeout_s, held by friction [rad or m]"
    )
    window_ticks: int = Field(ge=4, description="readings averaged to judge it [ticks]")
    timeout_s: float = Field(gt=0, description="testbed time after which a motion counts as not settled [s]")


class Servo(Model):
    """The loop."""

    period_s: float = Field(gt=0, le=0.1)
    planning_divisor: int = Field(ge=1, le=100, description="servo ticks between evaluations of a trajectory")
    priority: int = Field(ge=1, le=99, description="SCHED_FIFO priority, where permitted")
    max_overruns: int = Field(ge=1, description="missed deadlines in a row that stop every motion")
    velocity_bandwidth_rad_s: float = Field(gt=0)
    brake_lead_ticks: int = Field(ge=1, description="torque is present this long before brakes release, and after")
    answer_timeout_s: float = Field(gt=0, description="power and brakes must obey within this testbed time [s]")
    rest_window_ticks: int = Field(ge=4, description="readings averaged at rest")
    settle: Settle


class Testbed(Model):
    """Where the channels are."""

    __test__ = False  # not a test class, whatever pytest thinks of the name

    driver: str = Field(pattern=r"^[\w.]+:\w+$")
    attach_timeout_s: float = Field(gt=0)


class Slot(Model):
    """A joint or gripper and the channel that drives it."""

    name: str
    kind: Literal["joint", "gripper"] = "joint"
    channel: int = Field(ge=0)


class Group(Model):
    """Slots that move together."""

    joints: tuple[str, ...] = Field(min_length=1)
    wrist: str | None = Field(default=None, description="frame whose pose the group controls, if it has one")


class Limits(Model):
    """Shares of the limits in the cell's parameter file that MCS allows itself, and bounds of its own."""

    position_margin: float = Field(ge=0, description="distance kept from the end stops [rad or m]")
    velocity: float = Field(gt=0, le=1)
    acceleration: float = Field(gt=0, le=1)
    jerk: float = Field(gt=0, le=1)
    torque: float = Field(gt=0, le=1)
    following_error_rad: float = Field(gt=0)
    following_error_m: float = Field(gt=0)


class Control(Model):
    """A control law and its parameters."""

    controller: str = Field(pattern=r"^[\w.]+:\w+$")
    parameters: dict[str, Any] = Field(default_factory=dict)


class Switching(Model):
    """Control laws that a group may be switched to at run time, beside the one it starts with."""

    handover_s: float = Field(gt=0, le=10, description="the torque of the law before fades over this time [s]")
    laws: dict[str, dict[str, Any]] = Field(default_factory=dict, description="parameters by module:Class")


class Planning(Model):
    """Defaults of the motion planning layer."""

    synchrony: Synchrony = Synchrony.PHASE
    max_points: int = Field(ge=1, description="points of one path")


class McsConfig(Model):
    """All of ``mcs.yaml``."""

    servo: Servo
    testbed: Testbed
    slots: tuple[Slot, ...]
    limits: Limits
    control: Control
    group_control: dict[str, Control] = Field(default_factory=dict)
    switching: Switching
    model_error: float = Field(
        default=0.0, gt=-1, le=10, description="share by which masses and inertias of the controller's model are wrong"
    )
    planning: Planning
    presets: dict[str, dict[str, Group]]
    preset: str
    clearance_m: float = Field(ge=0, description="smallest distance between bodies that a path may have [m]")

    @property
    def groups(self) -> dict[str, Group]:
        """Groups of the preset in force."""
        return self.presets[self.preset]

    @property
    def joint_slots(self) -> tuple[Slot, ...]:
        """Slots of joints, in order."""
        return tuple(slot for slot in self.slots if slot.kind == "joint")

    @property
    def gripper_slots(self) -> tuple[Slot, ...]:
        """Slots of grippers, in order."""
        return tuple(slot for slot in self.slots if slot.kind == "gripper")

    def with_preset(self, preset: str) -> Self:
        """The same with another partition of the joints.

        Raises:
            NotFoundError: There is no such preset.
        """
        if preset not in self.presets:
            raise NotFoundError(kind="preset", name=preset, known=sorted(self.presets))
        return self.model_copy(update={"preset": preset})

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.preset not in self.presets:
            raise ValueError(f"preset '{self.preset}' is not one of {', '.join(sorted(self.presets))}")
        names = [slot.name for slot in self.slots]
        if len(set(names)) != len(names):
            raise ValueError("two slots have the same name")
        joints = {slot.name for slot in self.joint_slots}
        for preset, groups in self.presets.items():
            for group, description in groups.items():
                for joint in description.joints:
                    if joint not in joints:
                        raise ValueError(
                            f"group '{group}' of preset '{preset}' names '{joint}', which is no joint slot"
                        )
        return self


def load_config(path: Path | None = None) -> McsConfig:
    """Read a configuration; without a path, the one that comes with the package.

    Raises:
        ConfigError: The file is missing or wrong; the message names file, line and field.
    """
    return load_model(path or package_file("im_mcs", "config/mcs.yaml"), McsConfig)
