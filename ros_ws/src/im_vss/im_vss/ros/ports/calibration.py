"""Port of the Service ``calibrate``: observations and known lengths from messages, the calibration as a report."""

import math
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from im_calibration import SeenLength
from im_calibration.problem.observations import observation_of, spots_of
from im_cell.calibration_report import report_fields
from im_core.errors import DataError
from im_core.message_paths import message_folders, resolve_below
from im_core.ros.messages.message_fields import filled
from im_msgs.msg import CalibrationReport, KnownLength
from im_msgs.srv import Calibrate
from im_vss.ros.ports.port import Port
from im_vss.services.calibrate import CalibrateRequest, CalibrateResult


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
        observations=tuple(observation_of(observation) for observation in message.observations),
        lengths=tuple(from_known_length(length, i) for i, length in enumerate(message.known_lengths)),
        target=getattr(message, "target", ""),  # bags of former versions have none
        directory=Path(message.directory) if message.directory else None,
        apply=message.apply,
    )


def from_known_length(message: KnownLength, number: int) -> SeenLength:
    """Return a known length from a message.

    Raises:
        DataError: A value is impossible, or a light has two spots of a camera.
    """
    place = f"known length {number}"
    if not (math.isfinite(message.length) and message.length > 0.0):
        raise DataError(f"{place} is {message.length:g} m, it must be finite and > 0", length=message.length)
    if not (math.isfinite(message.sd) and message.sd >= 0.0):
        raise DataError(f"the sd of {place} is {message.sd:g} m, it must be finite and >= 0", sd=message.sd)
    first, second = spots_of(message.first, f"{place}, first"), spots_of(message.second, f"{place}, second")
    return SeenLength(message.length, message.sd, (first, second))
