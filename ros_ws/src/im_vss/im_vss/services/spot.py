"""Services for the spot of a light or the points of a target: in an image, a stereo pair, and in looks."""

import threading
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_calibration.targets.detection import Detection
from im_calibration.targets.target import chessboard_of
from im_cell.frames import Exposed, nobody
from im_core.errors import FOREIGN, ConfigError, DataError, as_exception
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.pending_looks import Look
from im_vss.services.service import VisionService
from im_vss.services.snap import SnapRequest
from im_vss.spot import SpotFinding
from im_vss.tools.display import TargetPoints
from im_vss.tools.spot import StereoFinding


@dataclass(frozen=True)
class SpotFindRequest:
    """Find the light, or a target, in each camera, all exposed at the same time.

    Attributes:
        cameras: Their names.
        exposure_s: Length of an exposure; 0: the nominal one [s].
        look: Name of a look whose images are searched; empty: images are taken now.
        target: Name of a target of the cell; empty: the light.
    """

    cameras: tuple[str, ...]
    exposure_s: float = 0.0
    look: str = ""
    target: str = ""


@dataclass(frozen=True)
class CameraSpot:
    """Finding of one camera: the name, testbed time of the exposure with light [ns], and the spot or the cause."""

    camera: str
    stamp_ns: int
    finding: SpotFinding


@dataclass(frozen=True)
class CameraView:
    """View of a target by one camera: the name, testbed time of the exposure [ns], points; None: it is not seen."""

    camera: str
    stamp_ns: int
    found: Detection | None


@dataclass(frozen=True)
class SpotFindResult:
    """The spots, or the views of a target, in the order of the request, and where the time went, by step [s].

    `remarks` are what the client of a look was told, for whoever asks for it.
    """

    spots: tuple[CameraSpot, ...]
    timing: dict[str, float]
    remarks: tuple[str, ...] = ()
    views: tuple[CameraView, ...] = ()


class SvcSpotFind(VisionService):
    """Service for spots: captures and shows images, computes and marks the spots (paper, section 5, SpotFind)."""

    name: ClassVar[str] = "spot_find"

    def serve(self, client: VisionClient, request: SpotFindRequest) -> SpotFindResult:
        """Find the spots: an exposure without light, one with light, common to all cameras; or the spots of a look.

        A target is found in one exposure without light.

        Raises:
            ImError: A camera is unknown, the exposure out of range, the cameras do not deliver, or the look is not
                known. A spot that is not found is no error: its finding says why.
        """
        if request.look:
            found: SpotFindResult = self.rig.looks.found(
                request.look, request.cameras, self.rig.settings.waits.hold, client.check
            )
            for remark in found.remarks:
                client.tell(remark)
            return found
        return find(self, client, request)


def find(
    service: VisionService, client: VisionClient, request: SpotFindRequest, exposed: Exposed = nobody
) -> SpotFindResult:
    """Find light or target in new images; arguments as of :func:`find_in_pairs`.

    Raises:
        ImError: See :meth:`SvcSpotFind.serve`.
    """
    watch = Stopwatch()
    cameras, exposure_s = request.cameras, request.exposure_s
    if not request.target:
        spots, timing = find_in_pairs(service, client, cameras, exposure_s, watch, exposed)
        return SpotFindResult(spots, {**timing, **watch.report()})
    target = chessboard_of(service.rig.cell, request.target)
    with watch.step("snap_s"):
        images = service.tool("tool_snap")(client, cameras, exposure_s, (True,), (True,), exposed=exposed)
    with watch.step("display_s"):
        service.tool("tool_image_disp")(client, images)
    frames = {camera: images.frames[camera][0] for camera in cameras}
    with watch.step("find_s"):
        found = {camera: service.tool("tool_target_find")(frame, target) for camera, frame in frames.items()}
    with watch.step("display_s"):
        marked = {camera: TargetPoints(request.target, detection) for camera, detection in found.items()}
        service.tool("tool_spot_disp")(client, marked)
    views = tuple(CameraView(camera, frames[camera].stamp_ns, detection) for camera, detection in found.items())
    return SpotFindResult((), {**images.timing, **watch.report()}, (), views)


def find_in_pairs(
    service: VisionService,
    client: VisionClient,
    cameras: tuple[str, ...],
    exposure_s: float,
    watch: Stopwatch,
    exposed: Exposed = nobody,
) -> tuple[tuple[CameraSpot, ...], dict[str, float]]:
    """The four Tools of SpotFind in turn.

    Args:
        service: Whose Tools are called.
        client: Who asks.
        cameras: Names of the cameras.
        exposure_s: Length of an exposure [s]; 0: the nominal one.
        watch: Counts the time of each Tool.
        exposed: Called when all is exposed, before the images are there.

    Returns:
        What each camera saw, and where the time of the exposures went, by step [s].

    Raises:
        ImError: See :meth:`SvcSpotFind.serve`.
    """
    lights: list[NDArray[np.float64] | None] = []

    def note_light(stamps_ns: tuple[int, ...]) -> None:
        lights.append(service.rig.light_position(stamps_ns[-1]))  # before the arm goes on, and is forgotten there
        exposed(stamps_ns)

    with watch.step("snap_s"):
        snap = service.tool("tool_snap")
        images = snap(client, cameras, exposure_s, (True, False), (True, True), exposed=note_light)
    with watch.step("display_s"):
        service.tool("tool_image_disp")(client, images)
    findings: dict[str, SpotFinding] = {}
    with watch.step("find_s"):
        for camera in cameras:
            off, on = images.frames[camera]
            findings[camera] = service.tool("tool_spot_find")(off, on, *lights)
            if (spot := findings[camera].spot) is not None:
                service.rig.outputs.spot(camera, (spot.u, spot.v), on.stamp_ns)
    with watch.step("display_s"):
        service.tool("tool_spot_disp")(client, findings)
    spots = tuple(CameraSpot(camera, images.frames[camera][1].stamp_ns, found) for camera, found in findings.items())
    return spots, images.timing


@dataclass(frozen=True)
class SpotFindStereoResult:
    """Finding of each camera, in the order of the request, the point, and the times of the steps [s].

    `remark` is what a user must know to trust the covariance; empty: nothing.
    """

    spots: tuple[CameraSpot, ...]
    stereo: StereoFinding
    timing: dict[str, float]
    remark: str


class SvcSpotFindStereo(VisionService):
    """As SpotFind with two cameras, and triangulated."""

    name: ClassVar[str] = "spot_find_stereo"

    def serve(self, client: VisionClient, request: SnapRequest) -> SpotFindStereoResult:
        """Find the light.

        Raises:
            ImError: The cameras are not two that are fixed to the world, the exposure is out of range, or the cameras
                do not deliver. A light that is not found is no error: the finding says why.
        """
        cameras = self.rig.settings.check_cameras(request.cameras)
        if len(cameras) != 2:
            raise ConfigError(f"stereo needs two cameras, got {len(cameras)}: {', '.join(cameras)}")
        for camera in cameras:
            if self.rig.book[camera].parent != "world":
                raise DataError(f"{camera} moves with {self.rig.book[camera].parent}: stereo needs fixed cameras")
        watch = Stopwatch()
        spots, timing = find_in_pairs(self, client, cameras, request.exposure_s, watch)
        with watch.step("triangulate_s"):
            findings = spots[0].finding, spots[1].finding
            stereo: StereoFinding = self.tool("tool_triangulate")((cameras[0], cameras[1]), findings)
        remark = "" if stereo.point is None else self.rig.book.remark(cameras)
        return SpotFindStereoResult(spots, stereo, {**timing, **watch.report()}, remark)


class SvcSpotLook(VisionService):
    """The first half of SpotFind: done when all is exposed; :class:`SvcSpotFind` has the second, by the look's name."""

    name: ClassVar[str] = "spot_look"

    def serve(self, client: VisionClient, request: SpotFindRequest) -> str:
        """Expose the images of a :class:`SvcSpotFind`, common to all cameras; return the name of the look.

        The images are read out and searched in a thread of their own, under the leases that any SpotFind has; once they
        are exposed, the search goes on for whoever asks for it, whatever becomes of this client.

        Raises:
            ImError: A camera or the target is unknown, the exposure out of range, or the cameras do not expose.
        """
        look: Look[SpotFindResult] = Look(request.cameras)
        shut: Future[str] = Future()
        remarks: list[str] = []
        searcher = VisionClient(client.name, lambda: shut.done() or not client.gone, remarks.append)

        def exposed(stamps_ns: tuple[int, ...]) -> None:
            name = str(stamps_ns[-1])  # testbed time: no other look of this testbed ends then
            self.rig.looks.keep(name, look)
            shut.set_result(name)

        def search() -> None:
            try:
                look.found.set_result(replace(find(self, searcher, request, exposed), remarks=tuple(remarks)))
            except FOREIGN as raised:  # of a user's frame source, too: it is for whoever waits for the result
                error = as_exception(raised)
                look.found.set_exception(error)
                if not shut.done():
                    shut.set_exception(error)

        threading.Thread(target=search, name=client.name, daemon=True).start()
        return shut.result()
