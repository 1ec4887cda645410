"""Node ``/vss``: ROS shell of the Vision Services System; translates messages, decides nothing."""

import json
import sys
import threading
import traceback
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from sensor_msgs.srv import SetCameraInfo

from im_core import names
from im_core.errors import ImError
from im_core.robot import load_cell
from im_core.robot.truth import FILE_NAME
from im_core.ros import run as ros_run
from im_core.ros.calls import run_in_thread
from im_core.ros.node import ManagedNode
from im_core.ros.status import ok_status, to_status
from im_core.ros.subprocess import ChildProcess
from im_msgs.srv import Calibrate, Snap, SpotFind
from im_vss.camera.host import CameraHost
from im_vss.camera_book import CameraBook
from im_vss.catalogue import load_catalogue
from im_vss.rig import Rig
from im_vss.ros.messages import (
    from_camera_info,
    from_observation,
    to_camera_info,
    to_image,
    to_report,
    to_spot,
)
from im_vss.ros.outputs import ImageOutputs
from im_vss.services.svc_calibrate import CalibrateRequest, CalibrateResult
from im_vss.services.svc_snap import SnapRequest, SnapResult
from im_vss.services.svc_spot_find import SpotFindRequest, SpotFindResult
from im_vss.settings import load_settings
from im_vss.vsm import VisionServicesManager

WATCH_PERIOD_S = 1.0


class VssNode(ManagedNode):
    """ROS shell of :class:`im_vss.vsm.VisionServicesManager`."""

    def __init__(self) -> None:
        super().__init__("vss")
        self.declare_parameter("settings", "")
        self.declare_parameter("cell", "")
        self._host: CameraHost | None = None
        self._vsm: VisionServicesManager | None = None

    def phase_configure(self) -> None:
        """Load the Services in use and start the camera process."""
        cell_file, settings_file = self._file("cell"), self._file("settings")
        cell = load_cell(cell_file)
        settings = load_settings(cell, settings_file)
        run_dir = names.run_dir()
        self._book = CameraBook(cell, settings.cameras, run_dir / "camera_info")
        self._outputs = ImageOutputs(self, self._book)
        self._book.on_change = self._outputs.publish_transforms
        spawn = partial(self._spawn, run_dir, cell_file, settings_file)
        self._host = CameraHost(names.instance(), cell, spawn, settings.renderer, settings.waits.camera_start)
        self._rig = Rig(settings, cell, self._book, self._host, self._outputs)
        self._vsm = VisionServicesManager(self._rig, load_catalogue())
        self._host.start()

    def phase_start(self) -> None:
        """Offer the Services, as soon as the cameras are ready."""
        assert self._host is not None
        assert self._vsm is not None
        self._host.wait_ready()
        self._outputs.publish_transforms()
        offered: dict[str, tuple[type, Callable[..., Any]]] = {
            "snap": (Snap, self._snap),
            "spot_find": (SpotFind, self._spot_find),
            "calibrate": (Calibrate, self._calibrate),
        }
        for name in self._vsm.services:
            kind, callback = offered[name]
            self.create_service(kind, f"/vss/{name}", callback)
        for entry in self._book.entries():
            self.create_service(
                SetCameraInfo, f"/{entry.name}/set_camera_info", partial(self._set_camera_info, entry.name)
            )
        self.create_timer(WATCH_PERIOD_S, self._watch, clock=self.steady_clock)
        # Loading these takes seconds that neither the start nor the first calibration need wait for.
        libraries = ("scipy.stats", "im_vss.calibration.plots")
        threading.Thread(target=lambda: [import_module(name) for name in libraries], daemon=True).start()

    def phase_shutdown(self) -> None:
        """End the camera process."""
        if self._vsm is not None:
            self._vsm.close()
        if self._host is not None:
            self._host.close()

    async def _snap(self, request: Snap.Request, response: Snap.Response) -> Snap.Response:
        def serve() -> None:
            result: SnapResult = self._request("snap", SnapRequest(tuple(request.cameras), request.exposure))
            for frame in result.frames:
                entry = self._book[frame.camera]
                response.images.append(to_image(entry.frame, frame.stamp_ns, frame.image))
                response.camera_infos.append(to_camera_info(entry, frame.stamp_ns))
            response.timing_json = json.dumps(result.timing)

        return await self._answer(response, serve)

    async def _spot_find(self, request: SpotFind.Request, response: SpotFind.Response) -> SpotFind.Response:
        def serve() -> None:
            result: SpotFindResult = self._request(
                "spot_find", SpotFindRequest(tuple(request.cameras), request.exposure)
            )
            response.spots = [to_spot(spot) for spot in result.spots]
            response.timing_json = json.dumps(result.timing)

        return await self._answer(response, serve)

    async def _calibrate(self, request: Calibrate.Request, response: Calibrate.Response) -> Calibrate.Response:
        def serve() -> None:
            result: CalibrateResult = self._request(
                "calibrate",
                CalibrateRequest(
                    cameras=tuple(request.cameras),
                    observations=tuple(from_observation(message) for message in request.observations),
                    directory=Path(request.directory) if request.directory else None,
                    apply=request.apply,
                ),
            )
            response.report = to_report(
                result.calibration,
                self._rig.cell.led.offset,
                result.calibration.message,
                directory=request.directory,
                json=json.dumps(result.report),
            )

        return await self._answer(response, serve)

    def _set_camera_info(
        self, camera: str, request: SetCameraInfo.Request, response: SetCameraInfo.Response
    ) -> SetCameraInfo.Response:
        try:
            path = self._book.set_intrinsics(camera, from_camera_info(request.camera_info))
        except ImError as error:
            response.status_message = error.message
            return response
        response.success = True
        response.status_message = f"{camera} is calibrated; written to {path.name}"
        return response

    def _request(self, service: str, request: Any) -> Any:
        assert self._vsm is not None
        return self._vsm.request(service, request)

    async def _answer(self, response: Any, serve: Callable[[], None]) -> Any:
        """Fill a response in a thread; what goes wrong becomes its status."""
        try:
            await run_in_thread(self, serve)
        except ImError as error:
            response.status = to_status(error)
        except Exception as error:  # a fault of this program must not end the node
            self.get_logger().error(traceback.format_exc())
            response.status = to_status(ImError(f"fault in /vss: {error!r}", code="internal"))
        else:
            response.success = True
            response.status = ok_status()
        return response

    def _watch(self) -> None:
        """Start the camera process again when it died."""
        if self._host is not None and (obituary := self._host.revive()):
            self.get_logger().error(f"{obituary}; it is started again")

    def _spawn(self, run_dir: Path, cell: Path | None, settings: Path | None, renderer: str) -> ChildProcess:
        arguments = ["--instance", names.instance(), "--truth", str(run_dir / FILE_NAME), "--renderer", renderer]
        arguments += ["--cell", str(cell)] if cell else []
        arguments += ["--settings", str(settings)] if settings else []
        return ChildProcess("im_vss.camera", arguments, run_dir / "camera.log")

    def _file(self, parameter: str) -> Path | None:
        value = str(self.get_parameter(parameter).value)
        return Path(value) if value else None


def main() -> int:
    """Entry point of the executable ``vss``."""
    return ros_run.main(VssNode)


if __name__ == "__main__":
    sys.exit(main())
