"""Port of the Service ``calibrate``."""

import json
from pathlib import Path
from typing import ClassVar

from im_msgs.srv import Calibrate
from im_vss.ros.calibration_messages import from_known_length, from_observation, to_report
from im_vss.ros.ports.port import Port
from im_vss.services.svc_calibrate import CalibrateRequest, CalibrateResult


class CalibratePort(Port):
    """`im_msgs/srv/Calibrate`."""

    kind: ClassVar[type] = Calibrate

    def request(self, message: Calibrate.Request) -> CalibrateRequest:
        """Cameras, observations and known lengths.

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

    def answer(self, result: CalibrateResult, response: Calibrate.Response) -> None:
        """The report."""
        response.report = to_report(
            result.calibration,
            self.rig.cell.led.offset,
            result.calibration.message,
            directory=str(result.directory) if result.directory is not None else "",
            json=json.dumps(result.report),
        )
