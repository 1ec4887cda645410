"""``vss_apart``: node of Services in a process without cameras, such as the calibration."""

import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from sensor_msgs.msg import CameraInfo

from im_calibration.recorded.stamps import stamp_of
from im_cell.robot import load_cell
from im_core import names
from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros import run as ros_run
from im_core.ros.calls import call_blocking, run_in_thread
from im_core.ros.messages.status import status_to_error
from im_msgs.msg import CalibrationFiles
from im_msgs.srv import TakeCalibration
from im_vss.camera_book import RemoteBook
from im_vss.camera_poses import Mounts
from im_vss.rig import Rig
from im_vss.ros.calibration_messages import TAKE, TRUTH, CalibrationReader, to_message
from im_vss.ros.light_tracker import LightTracker
from im_vss.ros.markers import ResidualMarkers
from im_vss.ros.services_node import FILES_S, ServicesNode
from im_vss.ros.state import DiagnosticsPort
from im_vss.settings import load_settings

MARKERS_PERIOD_S = 1.0


class ApartNode(ServicesNode):
    """Node of Services that need no camera: it follows the calibrations in use, and hands new ones to ``/vss``."""

    def __init__(self) -> None:
        super().__init__("vss_apart")

    def phase_configure(self) -> None:
        """Load the Services, and follow cameras and arms."""
        cell = load_cell()
        settings = load_settings(cell, self._file("settings"))
        self._taking = self.create_client(TakeCalibration, TAKE)
        self._book = RemoteBook(cell, settings.cameras, settings.stereo.pairs or (), self._hand_over)
        self._reader = CalibrationReader(cell, settings.cameras, names.run_dir() / f"calibration_{self.get_name()}")
        tracker = LightTracker(self, cell, settings.light.name, settings.region.freshness, 0.0)
        mounts = Mounts(tracker.wrist)
        for entry in self._book.entries():
            if entry.parent != "world":  # with each image comes a camera info of its stamp
                note = partial(_note, mounts, entry.parent)
                self.create_subscription(CameraInfo, f"/{entry.name}/camera_info", note, qos.IMAGES)
        self.load_services(
            Rig(
                settings,
                cell,
                self._book,
                None,
                None,
                light_position=tracker.position,
                why_dark=tracker.why_dark,
                mounts=mounts,
            )
        )

    def phase_start(self) -> None:
        """Offer the Services."""
        self.create_subscription(CalibrationFiles, TRUTH, self._follow_calibrations, qos.LATCHED)
        DiagnosticsPort(self, self.offer_services(), None, None)
        markers = ResidualMarkers(self, self._book)
        self.create_timer(MARKERS_PERIOD_S, markers.publish, clock=self.steady_clock)

    def _follow_calibrations(self, message: CalibrationFiles) -> None:
        self.spawn(self._adopt(message))

    async def _adopt(self, message: CalibrationFiles) -> None:
        try:
            taken = partial(self._reader.use, message, self._book, Path(message.folder))
            await run_in_thread(self, taken, timeout_s=FILES_S)
        except ImError as error:
            self.get_logger().error(f"the calibrations in use cannot be followed: {error.message}")

    def _hand_over(self, files: Mapping[str, str]) -> Path:
        """Have ``/vss`` use the files of a calibration; return their folder there."""
        request = TakeCalibration.Request(files=to_message(files, Path()))
        answer = call_blocking(self._taking, request, FILES_S, "/vss to take the calibration")
        if not answer.success:
            raise status_to_error(answer.status)
        return Path(answer.folder)


def _note(mounts: Mounts, frame: str, message: CameraInfo) -> None:
    mounts.note(frame, [stamp_of(message.header)])


def main() -> int:
    """Entry point of the executable ``vss_apart``."""
    return ros_run.main(ApartNode)


if __name__ == "__main__":
    sys.exit(main())
