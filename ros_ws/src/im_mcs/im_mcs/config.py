"""Configuration of MCS: ``config/mcs.yaml`` as frozen, checked models."""

from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from im_core.config import FieldError, Model, load_model, package_file
from im_core.errors import ConfigError, NotFoundError
from im_mcs.settings import (
    Collision,
    Control,
    Group,
    LawProcesses,
    Limits,
    PayloadLimits,
    Planning,
    Protective,
    Safety,
    Servo,
    Switching,
)
from im_mcs.testbed.declaration import Slot, Testbed, check_slots

__all__ = [
    "Collision",
    "Control",
    "Group",
    "LawProcesses",
    "Limits",
    "McsConfig",
    "PayloadLimits",
    "Planning",
    "Protective",
    "Safety",
    "Servo",
    "Slot",
    "Switching",
    "Testbed",
    "load_config",
]


class McsConfig(Model):
    """All of ``mcs.yaml``."""

    servo: Servo
    testbed: Testbed
    slots: tuple[Slot, ...]
    limits: Limits
    safety: Safety
    control: Control
    group_control: dict[str, Control] = Field(default_factory=dict)
    switching: Switching
    law_processes: LawProcesses = Field(default_factory=LawProcesses)
    payload: PayloadLimits
    model_error: float = Field(
        default=0.0, gt=-1, le=10, description="share by which masses and inertias of the controller's model are wrong"
    )
    planning: Planning
    protective: Protective
    presets: dict[str, dict[str, Group]]
    preset: str
    collision: Collision

    @property
    def groups(self) -> dict[str, Group]:
        """Groups of the preset in force."""
        return self.presets[self.preset]

    def parameters_of_laws(self, group: str) -> dict[str, dict[str, Any]]:
        """Parameters, by ``module:Class``, of every control law that a group may have."""
        first = self.group_control.get(group, self.control)
        return {**self.switching.laws, first.controller: first.parameters}

    @property
    def joint_slots(self) -> tuple[Slot, ...]:
        """Slots of joints, in order."""
        return tuple(slot for slot in self.slots if slot.kind == "joint")

    @property
    def gripper_slots(self) -> tuple[Slot, ...]:
        """Slots of grippers, in order."""
        return tuple(slot for slot in self.slots if slot.kind == "gripper")

    @property
    def wrench_slots(self) -> tuple[Slot, ...]:
        """Slots of wrist force-torque sensors, in order."""
        return tuple(slot for slot in self.slots if slot.kind == "wrench")

    def with_preset(self, preset: str) -> Self:
        """The same with another partition of the joints.

        Raises:
            NotFoundError: There is no such preset.
        """
        if preset not in self.presets:
            raise NotFoundError(kind="preset", name=preset, known=sorted(self.presets))
        return self.model_copy(update={"preset": preset})

    def at_period(self, period_s: float) -> Self:
        """The same with another servo period [s]; what is counted in ticks takes as long as it did.

        Raises:
            ConfigError: The period, or a number of ticks that follows from it, is out of range.
        """
        if not period_s > 0.0:
            raise ConfigError(f"servo period {period_s:g} s is not > 0", period=period_s)
        ratio = self.servo.period_s / period_s
        servo = self.servo.model_dump()
        settle = servo["settle"]
        servo |= {"period_s": period_s, "settle": {**settle, "window_ticks": round(settle["window_ticks"] * ratio)}}
        for name in ("planning_divisor", "brake_lead_ticks", "rest_window_ticks"):
            servo[name] = max(1, round(servo[name] * ratio))
        try:
            return self.model_copy(update={"servo": Servo.model_validate(servo)})
        except ValidationError as error:
            fault = error.errors()[0]
            where = ".".join(str(part) for part in fault["loc"])
            raise ConfigError(f"with a servo period of {period_s:g} s, servo.{where}: {fault['msg']}") from None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.preset not in self.presets:
            known = ", ".join(sorted(self.presets))
            raise FieldError(("preset",), f"preset '{self.preset}' is not one of {known}")
        check_slots(self.testbed, self.slots)
        self._check_laws()
        self._check_groups()
        return self

    def _check_laws(self) -> None:
        known = {self.control.controller, *self.switching.laws, *(c.controller for c in self.group_control.values())}
        for rank, law in enumerate(self.law_processes.laws):
            if law not in known:
                where = ("law_processes", "laws", rank)
                raise FieldError(where, f"'{law}' is none of the control laws: {', '.join(sorted(known))}")

    def _check_groups(self) -> None:
        joints = {slot.name for slot in self.joint_slots}
        for preset, groups in self.presets.items():
            for group, description in groups.items():
                for rank, joint in enumerate(description.joints):
                    if joint not in joints:
                        where = ("presets", preset, group, "joints", rank)
                        raise FieldError(where, f"'{joint}', which is no joint slot")


def load_config(path: Path | None = None) -> McsConfig:
    """Read a configuration; without a path, the one that comes with the package.

    Raises:
        ConfigError: The file is missing or wrong; the message names file, line and field.
    """
    return load_model(path or package_file("im_mcs", "config/mcs.yaml"), McsConfig)
