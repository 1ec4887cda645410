"""The cell: parameters of ``cell.yaml`` and derived values."""

import os
import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from im_cell.robot.objects import ObjectsFile
from im_cell.robot.parameters import (
    ArmModel,
    Box,
    BrakeSpec,
    Camera,
    Capsule,
    Cart,
    EncoderSpec,
    Gripper,
    Led,
    Number,
    Side,
    Size,
    WristSensor,
)
from im_cell.robot.scenery import Lamp, LaserScanner, Mirror, Optics, Target
from im_cell.robot.tree import CART_LINKS, Joint, LinkInertia, joints_of, links_of
from im_core.config import FieldError, load_model, package_file
from im_core.errors import ConfigError
from im_core.names import CELL, OBJECTS
from im_core.text.yamltext import Location

SIDES = ("left", "right")
_WORLD = "world"
_TOPIC = re.compile("[A-Za-z][A-Za-z0-9_]{0,63}")

_SHORTEST_S = 1e-4
"""Shortest tick of the testbed: times are told in whole nanoseconds, and one that is none would let no time pass."""


class Cell(ObjectsFile):
    """Everything known about the cell before calibration.

    >>> cell.home[:3].tolist(), cell.per_joint("limits.torque")[:3].tolist()
    ([-0.6, 0.0, 0.0], [1500.0, 600.0, 900.0])
    >>> cell.at_period(0.009).substeps == 2 * cell.substeps
    True
    """

    period: Annotated[float, Field(ge=_SHORTEST_S)]
    substeps: Annotated[int, Field(ge=1, le=64)]
    gravity: Number
    arm_models: dict[str, ArmModel]
    cart: Cart
    sides: dict[str, Side]
    encoder: EncoderSpec
    brakes: BrakeSpec
    gripper: Gripper
    wrist_sensor: WristSensor
    led: Led
    boxes: tuple[Box, ...]
    cameras: dict[str, Camera]
    camera_body: Size
    optics: Optics
    targets: tuple[Target, ...]
    mirrors: tuple[Mirror, ...]
    lamps: tuple[Lamp, ...]
    laser: LaserScanner

    @model_validator(mode="after")
    def _references(self) -> Self:
        if tuple(self.sides) != SIDES:
            raise ValueError(f"sides are {list(self.sides)}, not {list(SIDES)}")
        for name, side in self.sides.items():
            if side.arm not in self.arm_models:
                raise ValueError(f"sides.{name}.arm: '{side.arm}' is not one of {sorted(self.arm_models)}")
        for joint, position in zip(self.joints, self.home, strict=True):
            if not joint.limits.lower <= position <= joint.limits.upper:
                raise ValueError(f"home of {joint.name}, {position}, is outside its limits")
        self._check_frames()
        return self

    def _check_frames(self) -> None:
        """Check the parts of the cell: each must be fixed to an existing frame."""
        arm_links = [f"link{number}" for number in range(1, 7)]
        frames = (_WORLD, *(link.name for link in self.links), *(f"{side}_wrist" for side in self.sides))
        fixed: list[tuple[Location, Sequence[Box | Capsule | Mirror], Sequence[str]]] = [
            (("cart", "capsules"), self.cart.capsules, CART_LINKS),
            (("cart", "boxes"), self.cart.boxes, CART_LINKS),
            *((("arm_models", name, "capsules"), arm.capsules, arm_links) for name, arm in self.arm_models.items()),
            (("boxes",), self.boxes, (_WORLD,)),
            (("mirrors",), self.mirrors, frames),
        ]
        for where, things, known in fixed:
            for rank, thing in enumerate(things):
                if thing.link not in known:
                    raise FieldError((*where, rank, "link"), f"'{thing.link}' is not one of {', '.join(known)}")
        for name, camera in self.cameras.items():
            if not _TOPIC.fullmatch(name):
                raise FieldError(("cameras", name), f"'{name}' names topics: letters, digits and _, a letter first")
            if camera.parent not in frames:
                where = ("cameras", name, "parent")
                raise FieldError(where, f"'{camera.parent}' is not one of {', '.join(frames)}")
        names = [box.name for box in self.boxes]
        for rank, name in enumerate(names):
            if name in names[:rank]:
                raise FieldError(("boxes", rank, "name"), f"two boxes have the same name, '{name}'")

    def at_period(self, period: float) -> Self:
        """Return the same cell with another tick [s]; the number of physics steps keeps the step length.

        Raises:
            ConfigError: The period is too short, or needs more steps than allowed.
        """
        if not period >= _SHORTEST_S:
            raise ConfigError(f"a testbed period of {period:g} s is not at least {_SHORTEST_S:g} s", period=period)
        substeps = max(1, round(self.substeps * period / self.period))
        if substeps > 64:
            raise ConfigError(f"a testbed period of {period:g} s is {substeps} physics steps; 64 are allowed")
        return self.model_copy(update={"period": period, "substeps": substeps})

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The 18 joints in order."""
        return tuple(
            joint
            for name, side in self.sides.items()
            for joint in joints_of(
                name, side, self.cart, self.arm_models[side.arm],
                self.encoder.counts_per_turn, self.encoder.noise_counts,
            )
        )  # fmt: skip

    @cached_property
    def links(self) -> tuple[LinkInertia, ...]:
        """The 18 links with mass, each the child of the joint of the same rank."""
        return tuple(
            link for name, side in self.sides.items() for link in links_of(name, self.cart, self.arm_models[side.arm])
        )

    @cached_property
    def capsules(self) -> tuple[Capsule, ...]:
        """Collision shapes of all moving links; adjacent links overlap."""
        return tuple(
            capsule.model_copy(update={"link": f"{name}_{capsule.link}"})
            for name, side in self.sides.items()
            for capsule in (*self.cart.capsules, *self.arm_models[side.arm].capsules)
        )

    @cached_property
    def obstacles(self) -> tuple[Box, ...]:
        """Boxes fixed to the world, not to be touched by anything."""
        return tuple(box for box in self.boxes if box.collision)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def home(self) -> NDArray[np.float64]:
        """Where the testbed starts, shape (18,) [rad or m]."""
        return np.array([position for side in self.sides.values() for position in side.home])

    @property
    def light_names(self) -> tuple[str, ...]:
        """Names of the wrist lights, in the order of the testbed link."""
        return tuple(f"{name}_led" for name in self.sides)

    def per_joint(self, attribute: str) -> NDArray[np.float64]:
        """One attribute of each joint (``rotor_inertia``, ``limits.torque``, ...), shape (18,)."""
        values: list[object] = list(self.joints)
        for part in attribute.split("."):
            values = [getattr(value, part) for value in values]
        return np.array(values, dtype=np.float64)


def load_cell(path: Path | str | None = None) -> Cell:
    """Read a cell's parameter file.

    Args:
        path: The file; None: the one named by the environment variable ``IM_CELL``, else the shipped one, with the
            free bodies of the file named by ``IM_OBJECTS``, if there is one.

    Raises:
        ConfigError: The file is missing or wrong; the message names file, line and value.

    >>> load_cell("nowhere.yaml")
    Traceback (most recent call last):
    im_core.errors.ConfigError: nowhere.yaml: cannot be read: No such file or directory
    """
    named = path or os.environ.get(CELL)
    cell = load_model(Path(named) if named else package_file("im_cell", "robot/cell.yaml"), Cell)
    if path is None and (beside := os.environ.get(OBJECTS)):
        return cell.model_copy(update={"objects": load_model(Path(beside), ObjectsFile).objects})
    return cell
