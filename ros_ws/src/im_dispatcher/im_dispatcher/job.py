"""The data of one calibrate_camera command: the loop variable, and what became of each pose.

It is plain data and lives in the memory of the command, so that a dispatcher that died goes on where it was. The
observations themselves are data objects; here are the names of their poses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from im_core.errors import DataError, NotFoundError
from im_dispatcher.poses_file import WristPose

#: Fewer poses cannot determine two cameras with eight intrinsics each and say how well.
FEWEST_POSES = 12

#: Failures that concern one pose only; everything else concerns the machine.
POSE_FAILURES = frozenset({"unreachable", "collision", "limit", "not_settled", "spot_not_found"})


@dataclass(frozen=True)
class Skipped:
    """A pose that was left out.

    Attributes:
        pose: Its name.
        reason: Why.
    """

    pose: str
    reason: str


def check(cameras: Sequence[str], poses: Sequence[WristPose], known_cameras: Sequence[str]) -> None:
    """Checks what a command asks for.

    Args:
        cameras: Names of the cameras to calibrate.
        poses: All poses, in order.
        known_cameras: Names of the cameras that exist.

    Raises:
        NotFoundError: An unknown camera.
        DataError: No camera, a camera named twice, or fewer poses than :data:`FEWEST_POSES`.
    """
    if not cameras:
        raise DataError("calibrate_camera needs at least one camera")
    for name in cameras:
        if name not in known_cameras:
            raise NotFoundError(kind="camera", name=name, known=known_cameras)
        if list(cameras).count(name) > 1:
            raise DataError(f"camera '{name}' is named twice", camera=name)
    if len(poses) < FEWEST_POSES:
        raise DataError(
            f"{len(poses)} poses are too few to calibrate a camera; at least {FEWEST_POSES} are needed",
            poses=len(poses),
            limit=FEWEST_POSES,
        )


@dataclass
class CalibrationJob:
    """Loop over the poses of one calibrate_camera command.

    Attributes:
        cameras: Names of the cameras to calibrate.
        poses: All poses, in order.
        directory: Folder of the report.
        kept: Names of the poses that were observed.
        skipped: Poses that were left out.
        taken: How many poses have been visited, the present one included.
    """

    cameras: list[str]
    poses: list[WristPose]
    directory: str
    kept: list[str] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    taken: int = 0

    @property
    def remaining(self) -> int:
        """The loop variable: poses not yet visited."""
        return len(self.poses) - self.taken

    @property
    def progress(self) -> float:
        """Share of the poses that are done, 0..1."""
        return (len(self.kept) + len(self.skipped)) / len(self.poses)

    @property
    def current(self) -> WristPose:
        """The pose being visited.

        Raises:
            DataError: None has been taken.
        """
        if self.taken == 0:
            raise DataError("no pose has been taken yet")
        return self.poses[self.taken - 1]

    def more_poses(self) -> bool:
        """Enabling function of loop_again; negated, of loop_done."""
        return self.remaining > 0

    def take(self) -> WristPose:
        """Count the loop variable down and give the next pose.

        Raises:
            DataError: None is left.
        """
        if self.remaining == 0:
            raise DataError("all poses have been visited")
        self.taken += 1
        return self.current

    def keep(self) -> None:
        """Note that the current pose has been observed."""
        self.kept.append(self.current.name)

    def skip(self, reason: str) -> None:
        """Leave out the current pose."""
        self.skipped.append(Skipped(self.current.name, reason))

    def dispensable(self, failure_code: str) -> bool:
        """Whether a failure concerns this pose only, and enough poses remain without it."""
        return failure_code in POSE_FAILURES and len(self.kept) + self.remaining >= FEWEST_POSES

    def to_dict(self) -> dict[str, object]:
        """The job as JSON data."""
        return {
            "cameras": self.cameras,
            "poses": [pose.model_dump(mode="json") for pose in self.poses],
            "directory": self.directory,
            "kept": self.kept,
            "skipped": [asdict(skipped) for skipped in self.skipped],
            "taken": self.taken,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "CalibrationJob":
        """The job that :meth:`to_dict` wrote."""
        return cls(
            cameras=list(data["cameras"]),
            poses=[WristPose.model_validate(pose) for pose in data["poses"]],
            directory=str(data["directory"]),
            kept=list(data["kept"]),
            skipped=[Skipped(**skipped) for skipped in data["skipped"]],
            taken=int(data["taken"]),
        )
