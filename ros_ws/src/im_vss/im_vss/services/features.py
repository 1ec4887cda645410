"""Services for circles, lines and fiducials."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from im_cell.frames import Frame
from im_cell.robot import Target
from im_core.errors import NotFoundError
from im_core.stopwatch import Stopwatch
from im_vss.edges import EllipseFit, LineFit
from im_vss.fiducial import FiducialFit
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService
from im_vss.tools.display import Circles, Fiducials, Lines, Seen
from im_vss.tools.spot import WHOLE, Region

Fit = TypeVar("Fit")
Gates = TypeVar("Gates")


@dataclass(frozen=True)
class FeatureFindRequest:
    """Search range for features; 0 stands for the configured value.

    Attributes:
        camera: Name of the camera.
        exposure_s: Length of the exposure [s].
        region: Part of the image.
    """

    camera: str
    exposure_s: float = 0.0
    region: Region = WHOLE


class FeatureFind(VisionService):
    """Service for features: takes, shows, and searches an image."""

    def find(
        self,
        client: VisionClient,
        request: FeatureFindRequest,
        tool: Callable[[Frame, Region, Gates], Sequence[Fit]],
        gates: Gates,
        mark: Callable[[tuple[Fit, ...]], Seen],
    ) -> tuple[tuple[Fit, ...], int, dict[str, float]]:
        """Find features.

        Args:
            client: Who asks.
            request: Where to look.
            tool: What finds them, called with image, region and gates.
            gates: What is to be found.
            mark: Makes of the features what the display shows.

        Returns:
            The features, testbed time of the exposure [ns], and where the time went, by step [s].

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        region, watch = self.region(request.camera, request.region), Stopwatch()
        images = self.shown(client, (request.camera,), request.exposure_s, watch)
        (frame,) = images.frames[request.camera]
        with watch.step("find_s"):
            found = tuple(tool(frame, region, gates))
        with watch.step("display_s"):
            self.tool("tool_spot_disp")(client, {request.camera: mark(found)})
        return found, frame.stamp_ns, {**images.timing, **watch.report()}


@dataclass(frozen=True)
class CircleFindRequest(FeatureFindRequest):
    """Search range for circles; 0 stands for the configured value.

    Attributes:
        radius_min: Smallest radius [px].
        radius_max: Largest radius [px].
    """

    radius_min: float = 0.0
    radius_max: float = 0.0


@dataclass(frozen=True)
class CircleFindResult:
    """The circles, clearest first, testbed time of the exposure [ns], and where the time went, by step [s]."""

    found: tuple[EllipseFit, ...]
    stamp_ns: int
    timing: dict[str, float]


class SvcCircleFind(FeatureFind):
    """Service for circles: takes and shows an image, and finds circles inside."""

    name: ClassVar[str] = "circle_find"

    def serve(self, client: VisionClient, request: CircleFindRequest) -> CircleFindResult:
        """Find circles.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        tool = self.tool("tool_circle_find")
        gates = tool.gates(request.radius_min, request.radius_max)
        return CircleFindResult(*self.find(client, request, tool, gates, Circles))


_AS_DRAWN = (
    "the lens of {} is not calibrated: it is taken as drawn, without distortion; long edges are bent or in pieces"
)


@dataclass(frozen=True)
class LineFindRequest(FeatureFindRequest):
    """Search range for straight edges; 0 stands for the configured value.

    Attributes:
        length_min: Shortest line [px].
    """

    length_min: float = 0.0


@dataclass(frozen=True)
class LineFindResult:
    """Result of a search for lines.

    Attributes:
        found: The lines, longest first.
        stamp_ns: Testbed time of the exposure [ns].
        timing: Where the time went, by step [s].
        remark: What a user must know to trust the lines; empty: nothing.
    """

    found: tuple[LineFit, ...]
    stamp_ns: int
    timing: dict[str, float]
    remark: str


class SvcLineFind(FeatureFind):
    """Service for lines: takes and shows an image, and finds straight edges inside."""

    name: ClassVar[str] = "line_find"

    def serve(self, client: VisionClient, request: LineFindRequest) -> LineFindResult:
        """Find straight edges.

        Raises:
            ImError: The camera is unknown, a value out of range, or the camera does not deliver.
        """
        tool = self.tool("tool_line_find")
        found = self.find(client, request, tool, tool.gates(request.length_min), Lines)
        book = self.rig.book
        remark = book.remark([request.camera]) if book[request.camera].lens_known else _AS_DRAWN.format(request.camera)
        return LineFindResult(*found, remark)


@dataclass(frozen=True)
class FiducialPoseRequest:
    """Wanted plates, by the number of the code (none: all of the cell); exposure 0 stands for the nominal one."""

    cameras: tuple[str, ...]
    ids: tuple[int, ...] = ()
    exposure_s: float = 0.0


@dataclass(frozen=True)
class SeenFiducial:
    """A plate: name of the camera, testbed time of the first exposure [ns], and the fit."""

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
    """Service for fiducials: takes and shows images, and computes the poses of plates relative to the cameras."""

    name: ClassVar[str] = "fiducial_pose"

    def serve(self, client: VisionClient, request: FiducialPoseRequest) -> FiducialPoseResult:
        """Find plates; plates in images of a camera without a calibrated lens are marked, but have no pose.

        Raises:
            ImError: A camera or a plate is unknown, the exposure out of range, or the cameras do not deliver.
        """
        wanted = self._wanted(request.ids)
        watch = Stopwatch()
        images = self.shown(client, request.cameras, request.exposure_s, watch, self.rig.settings.fiducials.images)
        found: list[SeenFiducial] = []
        causes: list[str] = []
        shown: dict[str, Fiducials] = {}
        with watch.step("find_s"):
            for camera in request.cameras:
                frames = images.frames[camera]
                fits, missed = self.tool("tool_fiducial_pose")(frames, wanted)
                if self.rig.book[camera].lens_known:
                    found += [SeenFiducial(camera, frames[0].stamp_ns, fit) for fit in fits]
                else:
                    causes.append(f"no pose from {camera}: its lens is not calibrated")
                why = [f"{wanted[number].name} in {camera} {cause}" for number, cause in missed.items()]
                causes += why
                shown[camera] = Fiducials(tuple(fits), "; ".join(why))
        with watch.step("display_s"):
            self.tool("tool_spot_disp")(client, shown)
        remark = self.rig.book.remark(dict.fromkeys(seen.camera for seen in found))
        return FiducialPoseResult(tuple(found), "; ".join(causes), {**images.timing, **watch.report()}, remark)

    def _wanted(self, ids: tuple[int, ...]) -> dict[int, Target]:
        """Return plates and prints of the cell, by number.

        Raises:
            NotFoundError: The cell has no plate of a number.
        """
        cell = self.rig.cell
        prints = [body.printed(body.start) for body in cell.objects]
        known = {each.id: each for each in (*cell.targets, *prints) if each is not None and each.kind == "fiducial"}
        for number in ids:
            if number not in known:
                raise NotFoundError(kind="fiducial", name=str(number), known=[str(one) for one in known])
        return {number: known[number] for number in ids or known}
