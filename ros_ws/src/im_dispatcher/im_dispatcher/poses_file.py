"""Files with predefined manipulator positions (paper, section 7)."""

import math
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from im_core.config import Model, load_model, package_file
from im_core.message_paths import message_folders, resolve_below
from im_core.text.yamltext import control_character

#: The cell's own poses, for the two ceiling cameras.
OWN_POSES = ("im_dispatcher", "poses/ceiling_40.yaml")

#: What of the length of a quaternion is rounding: dividing by it would change the last digits each time it is read.
ROUNDING = 1e-12

Coordinate = Annotated[float, pydantic.Field(ge=-100.0, le=100.0)]
Quaternion = tuple[float, float, float, float]


class WristPose(Model):
    """One position of the wrist frame.

    Attributes:
        name: Its name in reports.
        position_m: Origin of the wrist frame in the world frame, within 100 m [m].
        orientation_xyzw: Unit quaternion world <- wrist.
    """

    name: Annotated[str, pydantic.Field(min_length=1, max_length=64)]
    position_m: tuple[Coordinate, Coordinate, Coordinate]
    orientation_xyzw: Quaternion

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
    """List of wrist poses of one arm, the one with the light."""

    group: Literal["left", "right"]
    frame: Literal["world"]
    poses: Annotated[tuple[WristPose, ...], pydantic.Field(min_length=1, max_length=1000)]

    @pydantic.field_validator("poses")
    @classmethod
    def _names_differ(cls, value: tuple[WristPose, ...]) -> tuple[WristPose, ...]:
        seen: set[str] = set()
        for pose in value:
            if pose.name in seen:
                raise ValueError(f"two poses are named '{pose.name}'")
            seen.add(pose.name)
        return value


def load_named_poses(path: str) -> PosesFile:
    """Read a poses file named by a message; of the package, or below the folders allowed for messages.

    Args:
        path: The file; empty for the cell's own.

    Raises:
        DataError: It is outside of those folders.
        ConfigError: It is missing, empty, or malformed; names file and line.
    """
    own = package_file(*OWN_POSES)
    if not path:
        return load_poses(own)
    folders = [*message_folders(), own.parent]
    return load_model(resolve_below(path, folders, "poses_file"), PosesFile, within=folders)


def load_poses(path: str | Path) -> PosesFile:
    """Read a poses file of the computer's user.

    Args:
        path: The file.

    Raises:
        ConfigError: It is missing, empty, or malformed; names file and line.
    """
    return load_model(path, PosesFile)
