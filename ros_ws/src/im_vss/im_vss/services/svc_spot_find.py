"""Service that finds the light spot."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Exposed, nobody
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService
from im_vss.spot import SpotFinding


@dataclass(frozen=True)
class SpotFindRequest:
    """Find the light in each camera, all exposed at the same time.

    Attributes:
        cameras: Their names.
        exposure_s: Length of an exposure; 0: the nominal one [s].
        look: Name of a look whose images are searched; empty: images are taken now.
    """

    cameras: tuple[str, ...]
    exposure_s: float = 0.0
    look: str = ""


@dataclass(frozen=True)
class CameraSpot:
    """What one camera saw: its name, testbed time of the exposure with light [ns], and the spot or the cause."""

    camera: str
    stamp_ns: int
    finding: SpotFinding


@dataclass(frozen=True)
class SpotFindResult:
    """The spots, in the order of the request, and where the time went, by step [s].

    `remarks` are what the client of a look was told, for whoever asks for it.
    """

    spots: tuple[CameraSpot, ...]
    timing: dict[str, float]
    remarks: tuple[str, ...] = ()


class SvcSpotFind(VisionService):
    """Captures images, shows them, computes the spots and marks them (paper, section 5, SpotFind)."""

    name: ClassVar[str] = "spot_find"

    def serve(self, client: VisionClient, request: SpotFindRequest) -> SpotFindResult:
        """Find the spots: an exposure without light, one with it, common to all cameras; or those of a look.

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
        watch = Stopwatch()
        spots, timing = find_in_pairs(self, client, request.cameras, request.exposure_s, watch)
        return SpotFindResult(spots, {**timing, **watch.report()})


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
                service.rig.screen.spot(camera, (spot.u, spot.v), on.stamp_ns)
    with watch.step("display_s"):
        service.tool("tool_spot_disp")(client, findings)
    spots = tuple(CameraSpot(camera, images.frames[camera][1].stamp_ns, found) for camera, found in findings.items())
    return spots, images.timing
