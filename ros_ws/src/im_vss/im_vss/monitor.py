"""The cameras' monitors: an image plane and an overlay each."""

import threading
from dataclasses import dataclass

import cv2
import numpy as np

from im_vss.frames import Frame, Image

_FOUND_COLOUR = (40, 255, 60)
_MISSED_COLOUR = (255, 90, 60)
_ARM_PX = (6, 18)
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Marker:
    """What to draw on a camera's monitor.

    Attributes:
        camera: Name of the camera.
        centre: Column and row of the spot [px]; None draws the text alone.
        text: A line at the lower edge.
    """

    camera: str
    centre: tuple[float, float] | None
    text: str


@dataclass(frozen=True)
class Picture:
    """What a monitor shows: red-green-blue image, shape (h, w, 3) [DN], and testbed time [ns]."""

    image: Image
    stamp_ns: int


class Monitors:
    """The newest image of each camera, ready to be drawn upon; shared by the two Vision Modules of the display."""

    def __init__(self) -> None:
        self._frames: dict[str, Frame] = {}
        self._lock = threading.Lock()

    def show(self, frame: Frame) -> None:
        """Put an image on its camera's monitor, without overlay."""
        with self._lock:
            self._frames[frame.camera] = frame

    def draw(self, marker: Marker) -> Picture | None:
        """The monitor's image with a marker on it; None if the monitor is dark."""
        with self._lock:
            frame = self._frames.get(marker.camera)
        if frame is None:
            return None
        image = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
        colour = _MISSED_COLOUR if marker.centre is None else _FOUND_COLOUR
        if marker.centre is not None:
            _cross(image, marker.centre)
        place = (8, image.shape[0] - 10)
        cv2.putText(image, marker.text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
        return Picture(image, frame.stamp_ns)


def _cross(image: Image, centre: tuple[float, float]) -> None:
    """Draw an open cross, exact to a sixteenth of a pixel."""
    scale = 1 << _SUBPIXEL_BITS
    u, v = centre
    for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        ends = [(round((u + r * du) * scale), round((v + r * dv) * scale)) for r in _ARM_PX]
        cv2.line(image, ends[0], ends[1], _FOUND_COLOUR, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
