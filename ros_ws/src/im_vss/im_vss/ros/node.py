"""Node ``/vss``: ROS shell of the Vision Services System; translates messages, decides nothing."""

import sys
from functools import partial
from pathlib import Path

from sensor_msgs.srv import SetCameraInfo

from im_cell.calibration_files import CalibrationFiles, read_calibration
from im_cell.frames import FrameSource, FrameSourceSetup
from im_cell.robot import Cell, load_cell
from im_core import clock, names, plugins
from im_core.errors import ImError, StoreError
from im_core.files import read_text, write_whole
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros import run as ros_run
from im_core.ros.calls import run_in_thread
from im_core.ros.messages.status import ok_status, to_status
from im_msgs.msg import CalibrationFiles as CalibrationFilesMessage
from im_msgs.srv import TakeCalibration
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Mounts
from im_vss.catalogue import PROCESS
from im_vss.laser.book import LaserBook
from im_vss.laser.scanner import LinkedScanner
from im_vss.rig import LaserRig, Rig
from im_vss.ros.calibration_messages import TAKE, TRUTH, CalibrationReader, to_message
from im_vss.ros.controls import ControlParameters, ImageStream
from im_vss.ros.light_tracker import LATE_S, LightTracker
from im_vss.ros.markers import CellMarkers
from im_vss.ros.messages import from_camera_info
from im_vss.ros.outputs import ImageOutputs
from im_vss.ros.services_node import FILES_S, ServicesNode
from im_vss.ros.state import DiagnosticsPort
from im_vss.services.snap import SnapRequest
from im_vss.settings import load_settings

WATCH_PERIOD_S = 1.0


class VssNode(ServicesNode):
    """ROS shell of :class:`im_vss.vsm.VisionServicesManager` in the process of the cameras."""

    def __init__(self) -> None:
        super().__init__(PROCESS)
        told = "folder of calibrations to start with; empty: as drawn"
        self._files["calibration"] = self.declared.declare("calibration", "", told)
        self._source: FrameSource | None = None
        self._laser: LaserRig | None = None

    def phase_configure(self) -> None:
        """Load the Services in use and start the cameras."""
        cell = load_cell()
        settings = load_settings(cell, self._file("settings"))
        self._kept = names.results_dir() / "vss" / f"{names.instance()}-{clock.stamp_name()}"
        self._book = CameraBook(cell, settings.cameras, self._kept, settings.stereo.pairs or ())
        laser_book = None if cell.laser is None else LaserBook(cell.laser, self._kept)
        self._in_use = None if self.get_parameter("standalone").value else names.run_dir() / names.CALIBRATION
        self._take_calibration(cell, laser_book)
        if laser_book is not None:
            self._laser = LaserRig(LinkedScanner(names.instance(), cell.scanner), laser_book)
            laser_book.on_change = self._calibrated
        self._outputs = ImageOutputs(self, self._book, laser_book)
        self._files_publisher = self.create_publisher(CalibrationFilesMessage, TRUTH, qos.LATCHED)
        self._reader = CalibrationReader(cell, settings.cameras, names.run_dir() / "calibration_taken")
        self._markers = CellMarkers(self, cell, self._book)
        self._book.on_change = self._calibrated
        frame_source = plugins.load(settings.frame_source.implementation, FrameSource, "frame source")
        setup = FrameSourceSetup(
            cell,
            settings.cameras,
            settings.sensor,
            settings.exposure.nominal,
            patience_s(),
            settings.frame_source.settings,
            self,
        )
        self._source = frame_source(setup)
        tracker = LightTracker(self, cell, settings.light.name, settings.region.freshness, LATE_S)
        rig = Rig(
            settings,
            cell,
            self._book,
            self._source,
            self._outputs,
            light_position=tracker.position,
            why_dark=tracker.why_dark,
            mounts=Mounts(tracker.wrist),
            laser=self._laser,
        )
        stream = ImageStream(self, self._take_images, self._source.await_image)
        self._controls = ControlParameters(self, settings, rig.controls, stream)
        self.load_services(rig)
        self._source.start()

    def phase_start(self) -> None:
        """Offer the Services, as soon as the cameras are ready."""
        assert self._source is not None
        self._source.wait_ready()
        self._publish_calibrations()
        vsm = self.offer_services()
        DiagnosticsPort(self, vsm, self._book, None if self._laser is None else self._laser.book)
        self.create_service(TakeCalibration, TAKE, self._take)
        for camera in self._book.entries():
            self.create_service(
                SetCameraInfo, f"/{camera.name}/set_camera_info", partial(self._set_camera_info, camera.name)
            )
        self._controls.start()
        self.create_timer(WATCH_PERIOD_S, self._watch, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """Let go of the cameras."""
        super().phase_shutdown()
        if self._laser is not None:
            self._laser.scanner.close()
        if self._source is not None:
            self._source.close()

    def _take_images(self, cameras: tuple[str, ...]) -> int:
        """Take and show an image with each camera; when the exposure ended, testbed time [ns].

        Raises:
            ImError: See :meth:`im_vss.services.snap.SvcSnap.serve`.
        """
        assert self._vsm is not None
        exposure_s = self._rig.controls.exposure(0.0, self._rig.settings.exposure.nominal)
        taken = self._vsm.request("snap", SnapRequest(cameras, exposure_s))
        return int(taken.frames[0].stamp_ns + (exposure_s / 2.0 + self._rig.cell.period) * 1e9)

    async def _set_camera_info(
        self, camera: str, request: SetCameraInfo.Request, response: SetCameraInfo.Response
    ) -> SetCameraInfo.Response:
        try:
            models = {camera: from_camera_info(request.camera_info)}
            folder = await run_in_thread(self, partial(self._book.set_cameras, models, pose=False), timeout_s=FILES_S)
        except ImError as error:
            response.status_message = error.message
            return response
        response.success = True
        response.status_message = f"{camera} has new intrinsics; written to {folder}"
        return response

    def _take_calibration(self, cell: Cell, laser_book: LaserBook | None) -> None:
        """Use the calibration of a former incarnation, or a given one, and log the origin of each part."""
        found = self._left(cell)
        if found is not None:
            self.get_logger().info(f"the calibration in use before is taken up again: {found.folder}")
        elif (folder := self._file("calibration")) is not None:
            found = read_calibration(folder, cell)
        if found is None:
            return
        for sentence in (*found.notes, *self._book.adopt(found)):
            self.get_logger().warning(sentence)
        told = [entry.told() for entry in self._book.entries()]
        if laser_book is not None:
            laser_book.adopt(found)
            told.append(laser_book.entry.told())
        self._note_in_use()
        for sentence in told:
            self.get_logger().info(sentence)

    def _left(self, cell: Cell) -> CalibrationFiles | None:
        """Return the calibration in use at the death of the task, in a continued mission; None: as at a start."""
        if self._in_use is None or not self._in_use.exists():
            return None
        try:
            return read_calibration(Path(read_text(self._in_use).strip()), cell)
        except ImError as error:
            self.get_logger().error(f"the calibration in use before is lost: {error.message}")
            return None

    def _calibrated(self) -> None:
        """Report a calibration taken into use, with written files; in any thread."""
        self._note_in_use()
        self._publish_calibrations()

    def _publish_calibrations(self) -> None:
        self._outputs.publish_calibrations()
        self._files_publisher.publish(to_message(self._book.files(), self._kept))

    async def _take(
        self, request: TakeCalibration.Request, response: TakeCalibration.Response
    ) -> TakeCalibration.Response:
        """Use a calibration of another process."""
        try:
            taken = partial(self._reader.use, request.files, self._book, self._kept)
            await run_in_thread(self, taken, timeout_s=FILES_S)
        except ImError as error:
            response.status = to_status(error)
            return response
        response.success, response.status, response.folder = True, ok_status(), str(self._kept)
        return response

    def _note_in_use(self) -> None:
        if self._in_use is None:
            return
        try:
            write_whole(self._in_use, f"{self._kept}\n")
        except StoreError as error:
            self.get_logger().error(f"the death of /vss would undo the calibration in use: {error.message}")

    def _watch(self) -> None:
        """Start the cameras again after the death, and show markers to viewers that have come."""
        self._markers.publish()
        if self._source is not None and (obituary := self._source.revive()):
            self.get_logger().error(f"{obituary}; it is started again")


def main() -> int:
    """Entry point of the executable ``vss``."""
    return ros_run.main(VssNode)


if __name__ == "__main__":
    sys.exit(main())
