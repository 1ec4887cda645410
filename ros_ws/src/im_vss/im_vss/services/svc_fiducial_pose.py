"""Service that finds fiducial plates and their poses."""

from dataclasses import dataclass
from typing import ClassVar

from im_cell.robot import Target
from im_core.errors import NotFoundError
from im_core.stopwatch import Stopwatch
from im_vss.fiducial import FiducialFit
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService
from im_vss.tools.tool_spot_disp import Fiducials


@dataclass(frozen=True)
class FiducialPoseRequest:
    """Which plates to find, by number of their code (none: all of the cell); exposure 0 stands for the nominal one."""

    cameras: tuple[str, ...]
    ids: tuple[int, ...] = ()
    exposure_s: float = 0.0


@dataclass(frozen=True)
class SeenFiducial:
    """A plate in an image: name of the camera, testbed time of the exposure [ns], and the fit."""

    camera: str
    stamp_ns: int
    fit: FiducialFit


@dataclass(frozen=True)
class FiducialPoseResult:
    """The plates by camera and number, why there are no others, and where the time went, by step [s].

    `remark` is what a user must know to trust the covariances; empty: nothing.
    """

    found: tuple[SeenFiducial, ...]
    cause: str
    timing: dict[str, float]
    remark: str


class SvcFiducialPose(VisionService):
    """Takes images, shows them, and computes where the cell's fiducial plates are relative to the cameras."""

    name: ClassVar[str] = "fiducial_pose"

    def serve(self, client: VisionClient, request: FiducialPoseRequest) -> FiducialPoseResult:
        """Find plates; in images of a camera that is not calibrated they are marked, but have no pose.

        Raises:
            ImError: A camera or a plate is unknown, the exposure out of range, or the cameras do not deliver.
        """
        wanted = self._wanted(request.ids)
        watch = Stopwatch()
        images = self.shown(client, request.cameras, request.exposure_s, watch)
        found: list[SeenFiducial] = []
        causes: list[str] = []
        shown: dict[str, Fiducials] = {}
        with watch.step("find_s"):
            for camera in request.cameras:
                (frame,) = images.frames[camera]
                fits, missed = self.tool("tool_fiducial_pose")(frame, wanted)
                if self.rig.book[camera].calibrated:
                    found += [SeenFiducial(camera, frame.stamp_ns, fit) for fit in fits]
                else:
                    causes.append(f"no pose from {camera}: it is not calibrated")
                why = [f"{wanted[number].name} in {camera} {cause}" for number, cause in missed.items()]
                causes += why
                shown[camera] = Fiducials(tuple(fits), "; ".join(why))
        with watch.step("display_s"):
            self.tool("tool_spot_disp")(client, shown)
        remark = self.rig.book.remark(dict.fromkeys(seen.camera for seen in found))
        return FiducialPoseResult(tuple(found), "; ".join(causes), {**images.timing, **watch.report()}, remark)

    def _wanted(self, ids: tuple[int, ...]) -> dict[int, Target]:
        """The plates of the cell, by number.

        Raises:
            NotFoundError: The cell has no plate of a number.
        """
        known = {target.id: target for target in self.rig.cell.targets if target.kind == "fiducial"}
        for number in ids:
            if number not in known:
                raise NotFoundError(kind="fiducial", name=str(number), known=[str(one) for one in known])
        return {number: known[number] for number in ids or known}
