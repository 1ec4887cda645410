"""Node ``/vss``: ROS shell of the Vision Services System; translates messages, decides nothing."""

import sys
import threading
import traceback
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from sensor_msgs.srv import SetCameraInfo

from im_cell.calibration_files import CalibrationFiles, read_calibration
from im_cell.frames import FrameSource, FrameSourceSetup
from im_cell.robot import Cell, load_cell
from im_core import clock, names, plugins
from im_core.errors import ImError, StoreError
from im_core.files import read_text, write_whole
from im_core.processes.startup import patience_s
from im_core.ros import run as ros_run
from im_core.ros.calls import run_in_thread
from im_core.ros.node import ManagedNode
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Mounts
from im_vss.catalogue import load_catalogue
from im_vss.laser.book import LaserBook
from im_vss.laser.scanner import LinkedScanner
from im_vss.rig import LaserRig, Rig
from im_vss.ros.client_liveness import Askers
from im_vss.ros.controls import ControlParameters, ImageStream
from im_vss.ros.light_tracker import LightTracker
from im_vss.ros.markers import CellMarkers
from im_vss.ros.messages import from_camera_info
from im_vss.ros.outputs import ImageOutputs
from im_vss.ros.ports import Port
from im_vss.ros.state import DiagnosticsPort, StatePort
from im_vss.services.snap import SnapRequest
from im_vss.settings import load_settings
from im_vss.vsm import PROCESS, VisionServicesManager

WATCH_PERIOD_S = 1.0

#: How long it may take to write the files of a calibration [s].
FILES_S = 30.0


#: Libraries of the calibration that take seconds to load, and at rest a fifth of the memory of this process.
_CALIBRATION = ("scipy.special", "scipy.stats", "im_calibration.reporting.plots")


class VssNode(ManagedNode):
    """ROS shell of :class:`im_vss.vsm.VisionServicesManager`."""

    def __init__(self) -> None:
        super().__init__("vss")
        declare = self.declared.declare
        self._files = {
            "settings": declare("settings", "", "file of the Services in use and their settings; empty: the package's"),
            "catalogue": declare("catalogue", "", "file of all Services that exist; empty: the package's"),
            "calibration": declare("calibration", "", "folder of calibrations to start with; empty: as drawn"),
        }
        self._process = declare("process", PROCESS, "name of this process in the catalogue; it runs the Services there")
        self._source: FrameSource | None = None
        self._vsm: VisionServicesManager | None = None
        self._laser: LaserRig | None = None
        self._loads_ahead = False

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
        self._markers = CellMarkers(self, cell, self._book, self._outputs.left)
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
        tracker = LightTracker(self, cell, settings.light.name, settings.region.freshness)
        self._rig = Rig(
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
        self._controls = ControlParameters(self, settings, self._rig.controls, stream)
        catalogue = load_catalogue(self._file("catalogue"))
        self._vsm = VisionServicesManager(self._rig, catalogue, self._process)
        self._source.start()

    def phase_start(self) -> None:
        """Offer the Services, as soon as the cameras are ready."""
        assert self._source is not None
        assert self._vsm is not None
        self._source.wait_ready()
        self._outputs.publish_calibrations()
        for name, entry in self._vsm.catalogue.services.items():
            port = plugins.load(entry.port, Port, "port")(self._rig)
            askers = Askers(self, f"/vss/{name}")
            self.create_service(port.kind, f"/vss/{name}", partial(self._serve, name, port, askers))
        StatePort(self, self._vsm)
        DiagnosticsPort(self, self._vsm, self._book, None if self._laser is None else self._laser.book)
        for camera in self._book.entries():
            self.create_service(
                SetCameraInfo, f"/{camera.name}/set_camera_info", partial(self._set_camera_info, camera.name)
            )
        self._controls.start()
        self.create_timer(WATCH_PERIOD_S, self._watch, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """Let go of the cameras."""
        if self._vsm is not None:
            self._vsm.close()
        if self._laser is not None:
            self._laser.scanner.close()
        if self._source is not None:
            self._source.close()

    async def _serve(self, name: str, port: Port, askers: Askers, request: Any, response: Any) -> Any:
        """Carry out a request of a Service, in a thread; an error becomes the status."""
        vsm = self._vsm
        assert vsm is not None
        self._load_ahead()
        alive = askers.present()
        remarks: list[str] = []

        def serve() -> None:
            port.answer(vsm.request(name, port.request(request), alive, remarks.append), response)

        try:
            await run_in_thread(self, serve)
        except ImError as error:
            port.refuse(error, response)
        except Exception as error:  # a fault of this program must not end the node
            self.get_logger().error(traceback.format_exc())
            port.refuse(ImError(f"fault in /vss: {error!r}", code="internal"), response)
        else:
            port.succeed(response, list(dict.fromkeys(remarks)))
        return response

    def _load_ahead(self) -> None:
        """Load the needs of a calibration beside the first request: neither the start nor the request has to wait."""
        if not self._loads_ahead:
            self._loads_ahead = True
            threading.Thread(target=lambda: [import_module(name) for name in _CALIBRATION], daemon=True).start()

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
        self._outputs.publish_calibrations()

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

    def _file(self, parameter: str) -> Path | None:
        value = self._files[parameter]
        return Path(value) if value else None


def main() -> int:
    """Entry point of the executable ``vss``."""
    return ros_run.main(VssNode)


if __name__ == "__main__":
    sys.exit(main())
