"""Service for images."""

from dataclasses import dataclass
from typing import ClassVar

from im_cell.frames import Frame
from im_core.stopwatch import Stopwatch
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService


@dataclass(frozen=True)
class SnapRequest:
    """Expose cameras, all at the same time; exposure 0 stands for the nominal one [s]."""

    cameras: tuple[str, ...]
    exposure_s: float = 0.0


@dataclass(frozen=True)
class SnapResult:
    """The images, in the order of the request, and where the time went, by step [s]."""

    frames: tuple[Frame, ...]
    timing: dict[str, float]


class SvcSnap(VisionService):
    """Takes and shows an image of each camera."""

    name: ClassVar[str] = "snap"

    def serve(self, client: VisionClient, request: SnapRequest) -> SnapResult:
        """Take the images.

        Raises:
            ImError: A camera is unknown, the exposure out of range, or the cameras do not deliver.
        """
        watch = Stopwatch()
        images = self.shown(client, request.cameras, request.exposure_s, watch)
        frames = tuple(images.frames[camera][0] for camera in request.cameras)
        return SnapResult(frames, {**images.timing, **watch.report()})
