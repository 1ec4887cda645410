"""What requests to the coordinators may say; other keys belong to whoever passed them on."""

from typing import Annotated

from pydantic import ConfigDict, Field

from im_core.arrivals import read_data
from im_core.config import Model

Name = Annotated[str, Field(min_length=1, max_length=64)]
Number = Annotated[int, Field(ge=1, le=100_000)]


class _Request(Model):
    model_config = ConfigDict(extra="ignore")


class CalibrationRequest(_Request):
    """Who takes part.

    Attributes:
        cameras: Which cameras look; none: those of the calibration under way.
        group: Which arm moves; None: the one that carries the light.
    """

    cameras: list[Name] = Field(default=[])
    group: Name | None = None


class KeptPose(_Request):
    """The pose whose observation is kept, by number and name."""

    number: Number
    pose: Name


class CollectedPoses(_Request):
    """What a calibration is made from.

    Attributes:
        cameras: Which cameras.
        observations: Numbers of the poses that were observed.
        rejected: Why others were not, by name of the pose.
        directory: Where the results go.
    """

    cameras: list[Name]
    observations: list[Number]
    rejected: dict[str, str]
    directory: str


def calibration_request(arguments: dict[str, object]) -> CalibrationRequest:
    """Reads who takes part.

    Raises:
        DataError: It makes no sense.
    """
    return read_data(CalibrationRequest, arguments, "the request to a coordinator")


def kept_pose(arguments: dict[str, object]) -> KeptPose:
    """Reads which pose is kept.

    Raises:
        DataError: It makes no sense.
    """
    return read_data(KeptPose, arguments, "the request to keep an observation")


def collected_poses(arguments: dict[str, object]) -> CollectedPoses | None:
    """Reads what a calibration is made from; None where the request names no observations.

    Raises:
        DataError: It makes no sense.
    """
    if "observations" not in arguments:
        return None
    return read_data(CollectedPoses, arguments, "the request to calibrate")
