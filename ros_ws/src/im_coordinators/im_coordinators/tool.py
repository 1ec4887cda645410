"""Place asked of a tool: the middle of the jaws, 15 cm before the wrist along z in the shipped cell."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_cell.rotations import UNIT_TOLERANCE, matrix_of_quaternion, matrix_of_rpy, quaternion_of_matrix
from im_core.errors import DataError, ImError

Array = NDArray[np.float64]

#: Tilt without a limit [rad].
ANY_TILT = 3.1416
#: Arguments of a request that say more of a ``position``, and those that a path must be planned for.
DETAILS = {"orientation": [], "frame": "world", "region": [], "yaw": 0.0}
PLANNED = {"region": [], "yaw": 0.0, "tilt": ANY_TILT}
#: Places of a region that are drawn, beside the nearest one and the middle.
_DRAWN = 6


@dataclass(frozen=True)
class WristPlacement:
    """Pose of a wrist in ``world``.

    Attributes:
        position: Shape (3,) [m].
        rotation: Rotation wrist -> world, shape (3, 3).
    """

    position: Array
    rotation: Array

    @classmethod
    def of(cls, position: Sequence[float], quaternion: Sequence[float]) -> "WristPlacement":
        """The pose with a position, shape (3,) [m], and a quaternion x, y, z, w."""
        return cls(np.array(position, dtype=np.float64), matrix_of_quaternion(quaternion))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Rotation of the target as a quaternion x, y, z, w."""
        return quaternion_of_matrix(self.rotation)


@dataclass(frozen=True)
class ToolTarget:
    """Where a request asks a tool to be.

    Attributes:
        group: The arm that carries the tool.
        position: Of the middle of the jaws, shape (3,) [m].
        orientation: Rotation of the tool, shape (3, 3); None: as it is.
        frame: What they are in: ``world``, or ``tool``, where the tool is now.
        region: Edges of the box around the position in which any place will do, along the axes of the frame, shape (3,)
            [m].
        yaw: Largest turn of the tool from its orientation about the z axis of the frame, either way [rad].
    """

    group: str
    position: tuple[float, ...]
    orientation: Array | None
    frame: str
    region: tuple[float, ...] = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    @classmethod
    def asked(cls, arguments: Mapping[str, object]) -> "ToolTarget":
        """Read the arguments of a request: ``group``, ``position``, ``orientation``, ``frame``, ``region``, ``yaw``.

        Raises:
            DataError: Position or region have not three numbers, or the orientation neither none, three nor four, or it
                is a quaternion whose norm is not 1.
        """
        position = _numbers(arguments["position"])
        if len(position) != 3:
            text = f"argument position has {len(position)} numbers; x y z [m] are needed"
            raise DataError(text, argument="position", value=list(position))
        turn = _rotation(_numbers(arguments["orientation"]))
        region = _numbers(arguments.get("region")) or (0.0, 0.0, 0.0)
        if len(region) != 3:
            text = f"argument region has {len(region)} numbers; the edges of a box along x y z [m] are needed"
            raise DataError(text, argument="region", value=list(region))
        (yaw,) = _numbers([arguments.get("yaw", 0.0)])
        return cls(str(arguments["group"]), position, turn, str(arguments["frame"]), region, yaw)

    def wrists(self, here: WristPlacement, reach: float) -> list[WristPlacement]:
        """Return placements of the wrist with the tool in the region: nearest to here, in the middle, and at random.

        The same request has the same ones. Arguments as of :meth:`wrist`.
        """
        middle = self.wrist(here, reach)
        half = np.array([*self.region, 2.0 * self.yaw]) / 2.0
        if not half.any():
            return [middle]
        axes = here.rotation if self.frame == "tool" else np.eye(3)
        along = np.array([0.0, 0.0, reach])
        centre = middle.position + middle.rotation @ along
        turn = axes.T @ here.rotation @ middle.rotation.T @ axes
        yaw = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        nearest = [*(axes.T @ (here.position + here.rotation @ along - centre)), yaw]
        drawn = np.random.Generator(np.random.Philox(0)).uniform(-half, half, (_DRAWN, 4))
        found = []
        for offset in (np.clip(nearest, -half, half), np.zeros(4), *drawn):
            rotation = axes @ matrix_of_rpy((0.0, 0.0, float(offset[3]))) @ axes.T @ middle.rotation
            found.append(WristPlacement(centre + axes @ offset[:3] - rotation @ along, rotation))
        return found

    def wrist(self, here: WristPlacement, reach: float) -> WristPlacement:
        """Return the placement of the wrist with the tool at the target.

        Args:
            here: Where it is now.
            reach: From the wrist along its z axis to the middle of the jaws [m].
        """
        along = np.array([0.0, 0.0, reach])
        if self.frame == "tool":
            turn = here.rotation if self.orientation is None else here.rotation @ self.orientation
            place = here.position + here.rotation @ (along + self.position)
        else:
            turn = here.rotation if self.orientation is None else self.orientation
            place = np.array(self.position)
        return WristPlacement(place - turn @ along, turn)

    def refusal(self, why: ImError) -> ImError:
        """Return the error for the target, with the reason why the tool cannot be there."""
        place = ", ".join(f"{each:g}" for each in self.position)
        around = " x ".join(f"{each:g}" for each in self.region)
        where = "world" if self.frame == "world" else "the frame of the tool as it is"
        near = f", nor at any place tried in the {around} m around it" if any(self.region) or self.yaw else ""
        text = f"the tool of {self.group} cannot be at ({place}) m in {where}{near}: {why.message}"
        return ImError.restored(why.code, text, {**why.facts, "position": list(self.position), "frame": self.frame})


def require_position(arguments: Mapping[str, object], way: str) -> None:
    """Check the details of a position: allowed only together with a position.

    Args:
        arguments: Of the request.
        way: Argument that says where to go.

    Raises:
        DataError: It comes with something else.
    """
    if way != "position":
        _require_defaults(arguments, DETAILS, "position", way)


def require_planned(arguments: Mapping[str, object], way: str) -> None:
    """Check a move without planning for what only a planned path can keep.

    Args:
        arguments: Of the request.
        way: Argument for which nothing is planned.

    Raises:
        DataError: It comes with a region, a yaw or a tilt.
    """
    _require_defaults(arguments, PLANNED, "a path that is planned", way)


def _require_defaults(arguments: Mapping[str, object], defaults: Mapping[str, object], needs: str, way: str) -> None:
    for name, default in defaults.items():
        if arguments[name] != default:
            raise DataError(f"argument {name} goes with {needs}; it was given with {way}", argument=name)


def _rotation(numbers: tuple[float, ...]) -> Array | None:
    match len(numbers):
        case 0:
            return None
        case 3:
            return matrix_of_rpy(numbers)
        case 4 if abs(math.hypot(*numbers) - 1.0) <= UNIT_TOLERANCE:
            return matrix_of_quaternion(numbers)
    text = f"argument orientation is {list(numbers)}; roll pitch yaw [rad] or a quaternion x y z w of norm 1 are needed"
    raise DataError(text, argument="orientation", value=list(numbers))


def _numbers(values: object) -> tuple[float, ...]:
    return tuple(float(value) for value in values) if isinstance(values, list | tuple) else ()
