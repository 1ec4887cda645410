"""One calibrate_camera command: what it asks for, and its loop over the poses.

What is asked for is read once, and is a data object from then on. The loop is three numbers, which the command keeps in
its memory, so that a dispatcher that died goes on where it was and a pose costs the journal the same whether it is the
first or the thousandth.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from im_core.errors import DataError, NotFoundError, StateError
from im_dispatcher.poses_file import PosesFile, load_poses

#: Cameras that are calibrated where none is named.
CEILING = ("ceiling_left", "ceiling_right")

#: Fewer poses cannot determine two cameras with eight intrinsics each and say how well.
FEWEST_POSES = 12

#: Failures that concern one pose only; everything else concerns the machine.
POSE_FAILURES = frozenset({"unreachable", "collision", "limit", "not_settled", "spot_not_found", "unusable"})


@dataclass(frozen=True)
class CalibrationOrder:
    """What a command asks for.

    Attributes:
        cameras: Names of the cameras to calibrate.
        file: All poses, in order, and the arm that carries the light through them.
    """

    cameras: tuple[str, ...]
    file: PosesFile

    @property
    def light(self) -> str:
        """Name of the light that the cameras look for."""
        return f"{self.file.group}_led"


def order_of(
    arguments: Mapping[str, object],
    known_cameras: Sequence[str],
    load: Callable[[str], PosesFile] = load_poses,
) -> CalibrationOrder:
    """Reads and checks what a command asks for.

    Args:
        arguments: Of the command, as its net declares them: ``cameras``, ``poses_file``, ``group``.
        known_cameras: Names of the cameras that exist.
        load: Gives the poses of a file.

    Raises:
        NotFoundError: An unknown camera.
        DataError: A camera named twice, fewer poses than :data:`FEWEST_POSES`, poses of the other arm, or arguments
            that no net has checked.
        ConfigError: The poses file is missing, empty, or malformed.
    """
    match arguments:
        case {"cameras": list(named), "poses_file": str(path), "group": str(group)}:
            cameras, file = tuple(map(str, named)) or CEILING, load(path)
        case _:
            raise DataError(f"calibrate_camera is to have cameras, poses_file and group, not {str(arguments)[:80]}")
    if file.group != group:
        raise DataError(f"the poses are those of the {file.group} arm, and the command has taken the {group} arm")
    for name in cameras:
        if name not in known_cameras:
            raise NotFoundError(kind="camera", name=name, known=known_cameras)
        if cameras.count(name) > 1:
            raise DataError(f"camera '{name}' is named twice", camera=name)
    if len(file.poses) < FEWEST_POSES:
        raise DataError(
            f"{len(file.poses)} poses are too few to calibrate a camera; at least {FEWEST_POSES} are needed",
            poses=len(file.poses),
            limit=FEWEST_POSES,
        )
    return CalibrationOrder(cameras, file)


@dataclass
class PoseLoop:
    """Loop over the poses of one command.

    Attributes:
        poses: How many there are.
        taken: How many have been visited, the present one included.
        skipped: How many of these were left out.
    """

    poses: int
    taken: int = 0
    skipped: int = 0

    @property
    def remaining(self) -> int:
        """The loop variable: poses not yet visited."""
        return self.poses - self.taken

    @property
    def progress(self) -> float:
        """Share of the poses that have been visited, 0..1."""
        return self.taken / self.poses

    def more_poses(self) -> bool:
        """Enabling function of loop_again; negated, of loop_done."""
        return self.remaining > 0

    def next_pose(self) -> int:
        """Count the loop variable down and give the number of the next pose, from 1.

        Raises:
            DataError: None is left.
        """
        if self.remaining == 0:
            raise DataError("all poses have been visited")
        self.taken += 1
        return self.taken

    def give_back(self) -> None:
        """Take back that the present pose was taken.

        Raises:
            DataError: None has been taken.
        """
        if self.taken == 0:
            raise DataError("no pose has been taken yet")
        self.taken -= 1

    def skip(self) -> int:
        """Leave out the present pose; returns how many were.

        Raises:
            DataError: None has been taken.
        """
        if self.taken == 0:
            raise DataError("no pose has been taken yet")
        self.skipped += 1
        return self.skipped

    def dispensable(self, failure_code: str) -> bool:
        """Whether a failure concerns the present pose only, and enough poses remain without it."""
        return failure_code in POSE_FAILURES and self.poses - self.skipped - 1 >= FEWEST_POSES

    def to_json(self) -> list[int]:
        """The loop as JSON data."""
        return [self.poses, self.taken, self.skipped]

    @classmethod
    def from_json(cls, data: object) -> "PoseLoop":
        """The loop that :meth:`to_json` wrote.

        Raises:
            StateError: There is none.
        """
        match data:
            case [int(poses), int(taken), int(skipped)]:
                return cls(poses, taken, skipped)
        raise StateError("no calibrate_camera command is running")
