"""Port of the Service ``calibrate``: observations and known lengths from messages, the calibration as a report."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.calibration_report import report_fields
from im_cell.rotations import matrix_of_quaternion
from im_core.errors import DataError
from im_core.message_paths import message_folders, resolve_below
from im_core.ros.messages.message_fields import filled
from im_msgs.msg import CalibrationReport, KnownLength, Spot
from im_msgs.msg import Observation as ObservationMessage
from im_msgs.srv import Calibrate
from im_vss.ros.ports.port import Port
from im_vss.services.calibrate import CalibrateRequest, CalibrateResult, Observation, SeenLength, SeenSpot

Array = NDArray[np.float64]


class CalibratePort(Port):
    """`im_msgs/srv/Calibrate`."""

    kind: ClassVar[type] = Calibrate

    def request(self, message: Calibrate.Request) -> CalibrateRequest:
        """Cameras, observations and known lengths.

        Raises:
            DataError: An observation or a known length is malformed, or the folder is outside of those that messages
                may name.
        """
        request = from_request(message)
        if request.directory is None:
            return request
        directory = resolve_below(str(request.directory), message_folders(), "directory")
        return replace(request, directory=directory)

    def answer(self, result: CalibrateResult, response: Calibrate.Response) -> None:
        """The report."""
        fields = report_fields({**result.report, "message": told(result)})
        response.report = filled(CalibrationReport(), fields, "report")
        response.report.directory = str(result.directory) if result.directory is not None else ""


def told(result: CalibrateResult) -> str:
    """Return the outcome as a sentence; a proposed lens model is named as the only one of the answer."""
    message = result.calibration.message
    if not any(verdict.lens for verdict in result.calibration.verdicts):
        return message
    where = f"{result.directory}/observations.json" if result.directory else "the observations, as a data set"
    return f"{message} The Service calibrate makes plumb_bob only: use the command calibrate_dataset on {where}."


def from_request(message: Calibrate.Request) -> CalibrateRequest:
    """Return cameras, observations and known lengths of a request, from a client or out of a bag.

    Raises:
        DataError: An observation or a known length is malformed.
    """
    return CalibrateRequest(
        cameras=tuple(message.cameras),
        observations=tuple(from_observation(observation) for observation in message.observations),
        lengths=tuple(from_known_length(length, i) for i, length in enumerate(message.known_lengths)),
        directory=Path(message.directory) if message.directory else None,
        apply=message.apply,
    )


def from_observation(message: ObservationMessage) -> Observation:
    """An observation from a message.

    Raises:
        DataError: It holds numbers that are not finite, or no rotation, or two spots of a camera.
    """
    position, q = message.wrist.position, message.wrist.orientation
    return Observation(
        pose=message.pose,
        position=np.array([position.x, position.y, position.z]),
        rotation=matrix_of_quaternion([q.x, q.y, q.z, q.w], f"the orientation of pose '{message.pose}'"),
        position_covariance=np.array(message.position_covariance).reshape(3, 3),
        spots=from_spots(message.spots, f"pose '{message.pose}'"),
    )


def from_known_length(message: KnownLength, number: int) -> SeenLength:
    """Return a known length from a message.

    Args:
        message: The message.
        number: Which it is of the request, for errors.

    Raises:
        DataError: A value is impossible, or a light has two spots of a camera.
    """
    place = f"known length {number}"
    if not (math.isfinite(message.length) and message.length > 0.0):
        raise DataError(f"{place} is {message.length:g} m, it must be finite and > 0", length=message.length)
    if not (math.isfinite(message.sd) and message.sd >= 0.0):
        raise DataError(f"the sd of {place} is {message.sd:g} m, it must be finite and >= 0", sd=message.sd)
    first, second = from_spots(message.first, f"{place}, first"), from_spots(message.second, f"{place}, second")
    return SeenLength(message.length, message.sd, (first, second))


def from_spots(messages: Sequence[Spot], place: str) -> dict[str, SeenSpot]:
    """Return spots of one light by camera, from messages, without spots not found.

    Args:
        messages: The messages.
        place: Of what they are, for errors.

    Raises:
        DataError: Two are of one camera, or a number is not finite, or a covariance is none.
    """
    spots: dict[str, SeenSpot] = {}
    for spot in messages:
        if not spot.found:
            continue
        if spot.camera in spots:
            raise DataError(f"{place} has two spots of {spot.camera}", camera=spot.camera)
        uv, covariance = np.array([spot.u, spot.v]), np.array(spot.covariance).reshape(2, 2)
        if not np.all(np.isfinite(uv)):
            raise DataError(f"{place}: the spot of {spot.camera} at {uv.tolist()} px is not finite", camera=spot.camera)
        if not is_covariance(covariance):
            raise DataError(f"{place}: {covariance.tolist()} is no covariance of a spot of {spot.camera} [px^2]")
        spots[spot.camera] = SeenSpot(uv, covariance, spot.stamp.sec * 10**9 + spot.stamp.nanosec)
    return spots


def is_covariance(matrix: Array) -> bool:
    """Whether a matrix, shape (n, n), is finite, symmetric and positive definite."""
    if not np.all(np.isfinite(matrix)) or np.abs(matrix - matrix.T).max() > 1e-6 * np.abs(matrix).max():
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)
