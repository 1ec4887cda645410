"""The data of one calibrate_camera command: the loop variable and what has been collected."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from im_core.errors import DataError, NotFoundError
from im_dispatcher.poses_file import WristPose

#: Fewer poses cannot determine two cameras with eight intrinsics each and say how well.
FEWEST_POSES = 12

#: Failures that concern one pose only; everything else concerns the machine.
POSE_FAILURES = frozenset({"unreachable", "collision", "limit", "not_settled", "spot_not_found"})

ObservationT = TypeVar("ObservationT")


@dataclass(frozen=True)
class Skipped:
    """A pose that was left out.

    Attributes:
        pose: Its name.
        reason: Why.
    """

    pose: str
    reason: str


@dataclass
class CalibrationJob(Generic[ObservationT]):
    """Loop over the poses of one calibrate_camera command.

    Args:
        cameras: Names of the cameras to calibrate.
        poses: All poses, in order.
        known_cameras: Names of the cameras that exist.

    Raises:
        NotFoundError: An unknown camera.
        DataError: No camera, a camera named twice, or fewer poses than :data:`FEWEST_POSES`.
    """

    cameras: Sequence[str]
    poses: Sequence[WristPose]
    known_cameras: Sequence[str]
    observations: list[ObservationT] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    taken: int = 0

    def __post_init__(self) -> None:
        if not self.cameras:
            raise DataError("calibrate_camera needs at least one camera")
        for name in self.cameras:
            if name not in self.known_cameras:
                raise NotFoundError(kind="camera", name=name, known=self.known_cameras)
            if list(self.cameras).count(name) > 1:
                raise DataError(f"camera '{name}' is named twice", camera=name)
        if len(self.poses) < FEWEST_POSES:
            raise DataError(
                f"{len(self.poses)} poses are too few to calibrate a camera; at least {FEWEST_POSES} are needed",
                poses=len(self.poses),
                limit=FEWEST_POSES,
            )

    @property
    def remaining(self) -> int:
        """The loop variable: poses not yet visited."""
        return len(self.poses) - self.taken

    @property
    def progress(self) -> float:
        """Share of the poses that are done, 0..1."""
        return (len(self.observations) + len(self.skipped)) / len(self.poses)

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

    def keep(self, observation: ObservationT) -> None:
        """Add the observation of the current pose."""
        self.observations.append(observation)

    def skip(self, reason: str) -> None:
        """Leave out the current pose."""
        self.skipped.append(Skipped(self.current.name, reason))

    def dispensable(self, failure_code: str) -> bool:
        """Whether a failure concerns this pose only, and enough poses remain without it."""
        return failure_code in POSE_FAILURES and len(self.observations) + self.remaining >= FEWEST_POSES
