"""Configuration of MCS: ``config/mcs.yaml`` as frozen, checked models."""

from collections.abc import Collection, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from im_cell.robot import Cell, Group, load_cell
from im_cell.robot.tree import WORLD
from im_core.config import FieldError, Model, fault_in, faults, load_model, package_file
from im_core.errors import ConfigError, NotFoundError, nearest
from im_core.rate_groups import Overrun, rate_fault
from im_mcs.limits.motion_limits import BeyondLimits, Synchrony
from im_mcs.limits.slots import LAW_METHODS, Interface, Kind, Slot, Testbed, check_slots, interface_of, slots_of

REFERENCE = r"^[\w.]+:\w+$"
"""Pattern of ``module:Class``."""


class Settle(Model):
    """When a group counts as at rest."""

    tolerance: float = Field(gt=0, description="largest mean error of each joint at rest [rad or m]")
    still_tolerance: float = Field(
        gt=0, description="largest mean error of an arm held by friction after half of timeout_s [rad or m]"
    )
    window_ticks: int = Field(ge=4, description="readings in the mean error [ticks]")
    timeout_s: float = Field(
        gt=0,
        description="testbed time until an unsettled motion fails, and blocked jaws count as at rest [s]",
    )


class Servo(Model):
    """The loop."""

    period_s: float = Field(gt=0, le=0.1)
    planning_divisor: int = Field(ge=1, le=100, description="servo ticks between evaluations of a trajectory")
    priority: int = Field(ge=1, le=99, description="SCHED_FIFO priority, where permitted")
    max_overruns: int = Field(ge=1, description="missed deadlines in a row that stop every motion")
    velocity_bandwidth_rad_s: float = Field(gt=0)
    brake_lead_ticks: int = Field(ge=1, description="ticks of torque before brakes release, and after they close")
    answer_timeout_s: float = Field(gt=0, description="testbed time within which power and brakes must obey [s]")
    rest_window_ticks: int = Field(ge=4, description="readings averaged at rest")
    owner_patience_s: float = Field(
        ge=0, le=10, description="at clock factor 0: wall time of a wait for the next request of an owner [s]"
    )
    settle: Settle
    sample_rate_hz: float = Field(default=50.0, ge=1, le=250, description="samples of the joints for topics [1/s]")


class LimitShares(Model):
    """Shares of the cell's limits used by MCS, and additional MCS bounds."""

    position_margin: float = Field(ge=0, description="distance kept from the end stops [rad or m]")
    velocity: float = Field(gt=0, le=1)
    acceleration: float = Field(gt=0, le=1)
    jerk: float = Field(gt=0, le=1)
    torque: float = Field(gt=0, le=1)
    following_error_rad: float = Field(gt=0)
    following_error_m: float = Field(gt=0)


class Safety(Model):
    """Bounds of the watches."""

    driver_age_s: float = Field(gt=0, description="age of a reading that causes a protective stop, testbed time [s]")
    driver_age_estop_s: float = Field(gt=0, description="age of a reading that causes an emergency stop [s]")
    brake_s: float = Field(gt=0, description="contradiction of a brake that causes an emergency stop [s]")
    owner_silence_s: float = Field(gt=0, description="longest silence of /mcs, in time with a processor [s]")
    servo_silence_s: float = Field(gt=0, description="longest silence of the servo, in time with a processor [s]")
    testbed_silence_s: float = Field(gt=0, description="longest wait for a tick, in time with a processor [s]")
    jerk_factor: float = Field(ge=1, description="jerk of a setpoint that is cut, as a multiple of the limit")
    record_s: float = Field(gt=0, le=60, description="time before an abort that is kept as evidence [s]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.driver_age_estop_s < self.driver_age_s:
            raise ValueError(f"driver_age_estop_s {self.driver_age_estop_s} is below driver_age_s {self.driver_age_s}")
        return self


class Control(Model):
    """Control law and the parameters."""

    controller: str = Field(pattern=REFERENCE)
    parameters: dict[str, Any] = Field(default_factory=dict)


class Switching(Model):
    """Control laws for a switch at run time, beside the first one of a group."""

    handover_s: float = Field(gt=0, le=10, description="time over which the torque of the previous law fades [s]")
    laws: dict[str, dict[str, Any]] = Field(default_factory=dict, description="parameters by module:Class")
    pair: str = Field(
        default="", description="module:Class, of the law of groups with two wrists; one of laws; empty: as all groups"
    )
    yielding: tuple[str, ...] = Field(
        default=(), description="module:Class, of laws without integral: an arm that stands still is at rest anywhere"
    )


class LawProcesses(Model):
    """Control laws in one process each, joined to the loop by the inter-processor blocking."""

    laws: tuple[str, ...] = Field(default=(), description="module:Class, of those under control and switching")
    patience: float = Field(default=0.4, gt=0, le=0.8, description="share of the period that a tick waits for torques")
    max_late: int = Field(default=5, ge=1, description="late answers in a row that count as an error of the law")


class ServoFunction(Model):
    """Function of the user's at servo rate, in the servo process."""

    function: str = Field(pattern=REFERENCE, description="module:name of what makes the function")
    every: int = Field(default=1, ge=1, description="servo ticks between two calls")
    times: int = Field(default=1, ge=1, description="calls in one servo tick")
    phase: int = Field(default=0, ge=0, description="tick of the first call, below `every`")
    overrun: Overrun = Field(default=Overrun.SKIP, description="what becomes of calls that a late loop has missed")
    budget_s: float = Field(gt=0, description="most that a call may take; a longer call is the last one [s]")
    parameters: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if fault := rate_fault(self.every, self.times, self.phase):
            raise ValueError(fault)
        return self


class PayloadLimits(Model):
    """Allowed payloads of an arm."""

    rated_kg: float = Field(gt=0)
    reach_m: float = Field(gt=0, description="largest offset of the centre of mass from the wrist, per axis [m]")


class Line(Model):
    """Straight lines of a wrist."""

    singular_value: float = Field(
        gt=0, lt=1, description="smallest singular value of the arm's Jacobian on a line, lengths divided by its reach"
    )
    deviation_m: float = Field(gt=0, description="largest distance of the commanded path from the line [m]")
    rotation_lever_m: float = Field(gt=0, description="distance equivalent to a rotation of one radian [m]")


class GoalSettings(Model):
    """When a trajectory without goal tolerances has come to its end."""

    rad: float = Field(default=5e-3, gt=0, description="largest error of a joint [rad]")
    m: float = Field(default=2e-3, gt=0, description="largest error of a track [m]")
    stopped_velocity: float = Field(default=0.02, gt=0, description="largest estimated velocity of each [rad/s or m/s]")


class NoiseSettings(Model):
    """How far noise of recorded positions is smoothed, where a trajectory names no path tolerance."""

    rad: float = Field(default=1e-3, gt=0, description="largest change of a joint's position [rad]")
    m: float = Field(default=1e-3, gt=0, description="largest change of a track's position [m]")


class Generators(Model):
    """Trajectory generators by kind of motion."""

    joint: str = Field(default="im_mcs.planning.motions.joint:JointPreparation", pattern=REFERENCE)
    line: str = Field(default="im_mcs.planning.line.line:LinePreparation", pattern=REFERENCE)


class Planning(Model):
    """Defaults of the motion planning layer."""

    synchrony: Synchrony = Synchrony.PHASE
    beyond_limits: BeyondLimits = Field(
        default=BeyondLimits.RETIME, description="retime trajectories beyond limits along their path, or refuse them"
    )
    max_points: int = Field(ge=1, description="most points of one path")
    max_trajectory_points: int = Field(ge=1, description="most points of one trajectory with times")
    goal: GoalSettings = GoalSettings()
    noise: NoiseSettings = NoiseSettings()
    generators: Generators = Generators()
    line: Line


class Protective(Model):
    """Protective stops."""

    patience_s: float = Field(ge=0, description="testbed time for which goals stay suspended, to be resumed [s]")


class Collision(Model):
    """Distances between bodies, from the loosest to the tightest."""

    slow_down_m: float = Field(gt=0, description="distance from a body at which motions begin to slow down [m]")
    clearance_m: float = Field(ge=0, description="smallest allowed distance of a planned path from a body [m]")
    stop_m: float = Field(gt=0, description="distance after braking below which a protective stop begins [m]")
    slowest: float = Field(gt=0, lt=1, description="share of full speed that is left at stop_m")
    reaction_ticks: int = Field(ge=0, description="servo ticks until a motion begins to brake")
    monitor: str = Field(default="im_mcs.collision.monitor:CollisionMonitor", pattern=REFERENCE)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.stop_m <= self.clearance_m <= self.slow_down_m or self.stop_m == self.slow_down_m:
            raise ValueError(
                f"stop_m {self.stop_m}, clearance_m {self.clearance_m}, slow_down_m {self.slow_down_m} "
                "do not increase: paths that are allowed would be stopped"
            )
        return self


class McsConfig(Model):
    """All of ``mcs.yaml``."""

    servo: Servo
    testbed: Testbed
    slots: tuple[Slot, ...] = Field(default=(), description="empty: all that the cell has, on the clock's driver")
    limits: LimitShares
    safety: Safety
    control: Control
    group_control: dict[str, Control] = Field(default_factory=dict)
    switching: Switching
    law_processes: LawProcesses = Field(default_factory=LawProcesses)
    functions: dict[str, ServoFunction] = Field(default_factory=dict, description="functions at servo rate, by name")
    payload: PayloadLimits
    model_error: float = Field(
        default=0.0, gt=-1, le=10, description="relative error of masses and inertias in the controller's model"
    )
    planning: Planning
    protective: Protective
    gripper_nodes: tuple[str, ...] = Field(
        default=(), description="nodes that drive the grippers of every owner of an arm"
    )
    presets: dict[str, dict[str, Group]] = Field(default_factory=dict, description="empty: the cell's")
    preset: str = Field(default="", description="empty: the first one")
    collision: Collision

    @property
    def groups(self) -> dict[str, Group]:
        """Groups of the preset in force."""
        return self.presets[self.preset]

    def control_of(self, group: str) -> Control:
        """Return the first control law of a group; of two wrists that of pairs, if the slots take its commands."""
        law, kind = self.switching.pair, interface_of(self.control.controller)
        two = any(groups[group].pair for groups in self.presets.values() if group in groups)
        if two and law in self.switching.laws and group not in self.group_control and interface_of(law) == kind:
            return Control(controller=law, parameters=self.switching.laws[law])
        return self.group_control.get(group, self.control)

    def parameters_of_laws(self, group: str) -> dict[str, dict[str, Any]]:
        """Return parameters, by ``module:Class``, of every possible control law of a group: all of one kind."""
        first = self.control_of(group)
        laws = {self.control.controller: self.control.parameters, **self.switching.laws}
        laws[first.controller] = first.parameters
        return {law: given for law, given in laws.items() if interface_of(law) == interface_of(first.controller)}

    def ranks_of(self, interface: Interface) -> tuple[int, ...]:
        """Return ranks of the joints with commands of a kind, among all joints."""
        return tuple(rank for rank, slot in enumerate(self.joint_slots) if slot.interface == interface)

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

    def at_sample_rate(self, rate_hz: float) -> Self:
        """Return the configuration with another rate of samples [1/s], of which the topics of the joints are made."""
        return self.model_copy(update={"servo": self.servo.model_copy(update={"sample_rate_hz": rate_hz})})

    def at_period(self, period_s: float) -> Self:
        """Return the configuration with another servo period [s]; times counted in ticks stay as long.

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
        reaction_ticks = round(self.collision.reaction_ticks * ratio)
        collision = self.collision.model_copy(update={"reaction_ticks": reaction_ticks})
        try:
            return self.model_copy(update={"servo": Servo.model_validate(servo), "collision": collision})
        except ValidationError as error:
            fault = faults(error, Servo)[0]
            sentence = f"with a servo period of {period_s:g} s, servo.{fault.field}: {fault.words}"
            raise ConfigError(sentence) from None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_slots(self.testbed, self.slots)
        self._check_laws()
        return self

    def _check_laws(self) -> None:
        if (pair := self.switching.pair) and pair not in (laws := self.switching.laws):
            raise FieldError(("switching", "pair"), f"'{pair}' is none of switching.laws: {', '.join(sorted(laws))}")
        known = {self.control.controller, *self.switching.laws, *(c.controller for c in self.group_control.values())}
        for rank, law in enumerate(self.law_processes.laws):
            if law not in known:
                where = ("law_processes", "laws", rank)
                raise FieldError(where, f"'{law}' is none of the control laws: {', '.join(sorted(known))}")
            if (kind := interface_of(law)) != "effort":
                where = ("law_processes", "laws", rank)
                raise FieldError(where, f"'{law}' gives {kind}; only a law of torques may have a process of its own")

    def of_cell(self, cell: Cell) -> Self:
        """Return the configuration with slots and presets of a cell, where it has none of its own.

        Raises:
            FieldError: A joint, device, frame, group or preset is named that there is not; joint slots have another
                order than the cell's joints; a preset has no groups; or the law of a group gives other commands than a
                slot of it takes.
        """
        self._check_slots(cell)
        presets = self.presets or cell.partitions
        frames = (WORLD, *cell.description.links, *cell.light_names)
        for preset, groups in self.presets.items():
            for name, group in groups.items():
                for frame in group.frames:
                    if frame not in frames:
                        where = ("presets", preset, name, "pair" if group.pair else "wrist")
                        raise FieldError(where, f"there is no frame '{frame}'{nearest(frame, frames)}")
        for name in self.group_control:
            known = [group for groups in presets.values() for group in groups]
            if name not in known:
                raise FieldError(("group_control", name), f"there is no group '{name}'{nearest(name, known)}")
        slots = self.slots or slots_of(cell, self.testbed.clock)
        self._check_groups(presets, {slot.name: slot.interface for slot in slots if slot.kind == "joint"})
        if (preset := self.preset or next(iter(presets))) not in presets:
            raise FieldError(("preset",), f"preset '{preset}' is not one of {', '.join(sorted(presets))}")
        return self.model_copy(update={"presets": presets, "slots": slots, "preset": preset})

    def _check_slots(self, cell: Cell) -> None:
        """Refuse slots with names of no joint or device of the cell, and joint slots in another order."""
        known: dict[Kind, Collection[str]] = {
            "joint": cell.joint_names, "gripper": cell.devices("gripper"), "wrench": cell.devices("force")
        }  # fmt: skip
        for rank, slot in enumerate(self.slots):
            if slot.name not in known[slot.kind]:
                text = f"'{slot.name}' is not a {slot.kind} of the cell{nearest(slot.name, known[slot.kind])}"
                raise FieldError(("slots", rank, "name"), text)
        for slot, joint in zip_longest(self.joint_slots, cell.joint_names) if self.slots else ():
            if slot is None or slot.name != joint:
                if slot is None:
                    raise FieldError(("slots",), f"joint {joint} of the cell has no slot")
                text = f"where {joint} is expected is the slot of {slot.name}; joint slots have the order of the cell's"
                raise FieldError(("slots", self.slots.index(slot), "name"), f"{text} joints")

    def _check_groups(self, presets: Mapping[str, Mapping[str, Group]], joints: Mapping[str, Interface]) -> None:
        for preset, groups in presets.items():
            if not groups:
                raise FieldError(("presets", preset), "the preset has no groups; at least 1 is needed")
            moved_by: dict[str, str] = {}
            for group, description in groups.items():
                for rank, joint in enumerate(description.joints):
                    where = ("presets", preset, group, "joints", rank)
                    if joint not in joints:
                        raise FieldError(where, f"'{joint}' is not a joint slot{nearest(joint, joints)}")
                    if joint in moved_by:
                        raise FieldError(where, f"'{joint}' is already in group '{moved_by[joint]}'")
                    moved_by[joint] = group
                    self._check_interface(group, joint, joints[joint])

    def _check_interface(self, group: str, joint: str, interface: Interface) -> None:
        """Refuse a joint with commands of another kind than the law of its group gives."""
        own = group in self.group_control
        law = (self.group_control[group] if own else self.control).controller
        gives = interface_of(law)
        if gives != interface:
            where = ("group_control", group, "controller") if own else ("control", "controller")
            raise FieldError(
                where,
                f"control law '{law}' gives {gives}, and slot '{joint}' of group '{group}' takes {interface}; its law "
                f"needs a method '{LAW_METHODS[interface]}'",
            )


def load_config(path: Path | None = None, cell: Cell | None = None) -> McsConfig:
    """Read a configuration for a cell.

    Args:
        path: The file; None: the one of the package.
        cell: Joints, and slots and presets where the file has none; None: the cell of the machine.

    Raises:
        ConfigError: The file is missing or wrong, or names what the cell has not; file, line and field are named.
    """
    path = path or package_file("im_mcs", "config/mcs.yaml")
    try:
        return load_model(path, McsConfig).of_cell(cell or load_cell())
    except FieldError as error:
        raise fault_in(path, error.location, str(error)) from error
