"""Files with predefined manipulator positions (paper, section 7)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import pydantic

from im_cell.robot import load_cell
from im_core.config import Model, load_model
from im_core.errors import ConfigError, DataError, StateError
from im_core.message_paths import message_folders, resolve_below
from im_core.text.yamltext import control_character

#: What of the length of a quaternion is rounding: dividing by it would change the last digits each time it is read.
ROUNDING = 1e-12

#: The other arm stands where it must if no joint is farther from there [rad or m].
NOT_THERE = 0.02

Coordinate = Annotated[float, pydantic.Field(ge=-100.0, le=100.0)]
Quaternion = tuple[float, float, float, float]


class WristPose(Model):
    """One position of the wrist frame.

    Attributes:
        name: Its name in reports.
        position_m: Origin of the wrist frame in the world frame, within 100 m [m].
        orientation_xyzw: Unit quaternion world <- wrist.
        joints: Positions of the group's joints there [rad or m]; None: any that reach it.
    """

    name: Annotated[str, pydantic.Field(min_length=1, max_length=64)]
    position_m: tuple[Coordinate, Coordinate, Coordinate]
    orientation_xyzw: Quaternion
    joints: Annotated[tuple[Coordinate, ...], pydantic.Field(min_length=1, max_length=32)] | None = pydantic.Field(
        None, exclude_if=lambda joints: joints is None
    )

    @property
    def stamped(self) -> dict[str, object]:
        """Fields of a ``geometry_msgs/msg/PoseStamped``."""
        position = dict(zip("xyz", self.position_m, strict=True))
        orientation = dict(zip("xyzw", self.orientation_xyzw, strict=True))
        return {"header": {"frame_id": "world"}, "pose": {"position": position, "orientation": orientation}}

    @pydantic.field_validator("name")
    @classmethod
    def _printable(cls, value: str) -> str:
        if sentence := control_character(value):
            raise ValueError(sentence)
        return value

    @pydantic.field_validator("orientation_xyzw")
    @classmethod
    def _unit(cls, value: Quaternion) -> Quaternion:
        norm = math.hypot(*value)
        if abs(norm - 1.0) > 1e-3:
            raise ValueError(f"the quaternion has length {norm:.4f}; it must be 1")
        if abs(norm - 1.0) <= ROUNDING:
            return value
        x, y, z, w = (component / norm for component in value)
        return (x, y, z, w)


class PosesFile(Model):
    """List of wrist poses of one arm, the one with the light.

    Attributes:
        other_joints: Where the other arm must stand, in the order of its joints [rad or m]; None: anywhere.
        order: Whether the poses are visited as they are listed, or ``free``: in the order that takes least time, by
            their joints.
    """

    group: Annotated[str, pydantic.Field(min_length=1, max_length=64)]
    frame: Literal["world"]
    other_joints: Annotated[tuple[Coordinate, ...], pydantic.Field(min_length=1, max_length=32)] | None = None
    order: Literal["given", "free"] = pydantic.Field("given", exclude_if=lambda order: order == "given")
    poses: Annotated[tuple[WristPose, ...], pydantic.Field(min_length=1, max_length=1000)]

    @pydantic.field_validator("group")
    @classmethod
    def _of_the_cell(cls, value: str) -> str:
        if value not in (groups := load_cell().groups):
            raise ValueError(f"the cell has no such group, but {', '.join(groups)}")
        return value

    @pydantic.field_validator("poses")
    @classmethod
    def _names_differ(cls, value: tuple[WristPose, ...]) -> tuple[WristPose, ...]:
        seen: set[str] = set()
        for pose in value:
            if pose.name in seen:
                raise ValueError(f"two poses are named '{pose.name}'")
            seen.add(pose.name)
        return value

    @pydantic.model_validator(mode="after")
    def _joints_fit(self) -> Self:
        names = load_cell().joints_of(self.group)
        for pose in self.poses:
            if pose.joints is not None and len(pose.joints) != len(names):
                raise ValueError(f"pose '{pose.name}' has {len(pose.joints)} joints; {self.group} has {len(names)}")
            if pose.joints is None and self.order == "free":
                raise ValueError(f"order: free needs the joints of each pose; pose '{pose.name}' has none")
        return self

    @property
    def other(self) -> str:
        """Name of the arm without the light."""
        return next((name for name in load_cell().groups if name != self.group), "")

    def require_other(self, joints: Sequence[str], positions: Sequence[float]) -> None:
        """Check that the other arm stands where the poses need it.

        Args:
            joints: Names of its joints.
            positions: Measured positions of them [rad or m].

        Raises:
            StateError: It stands elsewhere.
            DataError: It has more or fewer joints than the file says.
        """
        needed = self.other_joints or ()
        if len(needed) != len(joints):
            told = f"other_joints of the poses has {len(needed)} positions"
            raise DataError(f"{told}, the {self.other} arm has {len(joints)} joints", argument="other_joints")
        far, joint, here, there = max(
            (abs(here - there), joint, here, there)
            for joint, here, there in zip(joints, positions, needed, strict=True)
        )
        if far > NOT_THERE:
            raise StateError(
                f"the poses are free of collisions while the {self.other} arm stands where they say: {joint} is at "
                f"{here:.3f}, not {there:.3f}; if that is home: im run home --group {self.other}",
                joint=joint,
                value=here,
                allowed=there,
            )


def load_named_poses(path: str, target: str = "light") -> PosesFile:
    """Read a poses file named by a message; one of the cell, or one below the folders allowed for messages.

    Args:
        path: The file; empty for the cell's own; a name without a folder also for one beside that.
        target: What the poses show to cameras, ``light`` or ``board``: the cell has poses for each.

    Raises:
        DataError: It is outside of those folders.
        ConfigError: It is missing, empty, or malformed; names file and line. Or the cell has no poses of its own.
    """
    cell = load_cell()
    own = cell.board_poses if target == "board" else cell.poses
    if not path and not own:
        told = f"the cell file names no poses for target {target}; give poses_file"
        raise ConfigError(f"{told} (`scripts/run.sh im_mcs poses --target {target}` finds poses)")
    if path in ("", own):
        return load_poses(own)
    for beside in Path(own).parent.glob("*.yaml") if own else ():
        if path == beside.name:
            return load_poses(beside)
    folders = message_folders()
    return load_model(resolve_below(path, folders, "poses_file"), PosesFile, within=folders)


def load_poses(path: str | Path) -> PosesFile:
    """Read a poses file of the computer's user.

    Raises:
        ConfigError: It is missing, empty, or malformed; names file and line.
    """
    return load_model(path, PosesFile)
