"""The cameras' monitors: an image plane and an overlay each."""

import threading
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Frame, Image

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

GREEN: Colour = (40, 255, 60)
RED: Colour = (255, 70, 60)
BLUE: Colour = (80, 150, 255)
_MISSED_COLOUR: Colour = (255, 90, 60)
_ARM_PX = (6, 18)
_FARTHEST_PX = 4096.0
_SUBPIXEL_BITS = 4
_FONT, _LABEL_SIZE, _TEXT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.38, 0.42


@dataclass(frozen=True)
class Curve:
    """Line through places of an image, shape (n, 2) [px], and the colour (red, green, blue)."""

    places: Array
    colour: Colour = GREEN


@dataclass(frozen=True)
class Label:
    """A word at a place of an image [px]."""

    place: tuple[float, float]
    text: str


@dataclass(frozen=True)
class Marker:
    """Overlay of a camera's monitor.

    Attributes:
        camera: Name of the camera.
        text: A line at the lower edge; red if nothing else is drawn.
        crosses: Column and row of points [px].
        curves: Lines.
        labels: Words.
    """

    camera: str
    text: str
    crosses: tuple[tuple[float, float], ...] = ()
    curves: tuple[Curve, ...] = ()
    labels: tuple[Label, ...] = ()


@dataclass(frozen=True)
class Picture:
    """Content of a monitor: red-green-blue image, shape (h, w, 3) [DN], and testbed time [ns]."""

    image: Image
    stamp_ns: int


class Screen(Protocol):
    """The monitors, and the outputs of images and spots."""

    def raw(self, frame: Frame) -> None:
        """Put out an image as taken."""

    def display(self, camera: str, image: Image, stamp_ns: int) -> None:
        """Show an image, shape (h, w, 3), red-green-blue [DN]."""

    def spot(self, camera: str, place: tuple[float, float], stamp_ns: int) -> None:
        """Put out where the light was found in an image, column and row [px]."""


class Monitors:
    """The newest image of each camera, ready to be drawn upon; shared by the two Vision Modules of the display."""

    def __init__(self) -> None:
        self._frames: dict[str, Frame] = {}
        self._lock = threading.Lock()

    def show(self, frame: Frame) -> None:
        """Put an image on the camera's monitor, without overlay."""
        with self._lock:
            self._frames[frame.camera] = frame

    def draw(self, marker: Marker) -> Picture | None:
        """Return the monitor's image with a marker drawn in; None if the monitor is dark."""
        with self._lock:
            frame = self._frames.get(marker.camera)
        if frame is None:
            return None
        image = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
        for curve in marker.curves:
            _curve(image, curve.places, curve.colour)
        for cross in marker.crosses:
            _cross(image, cross)
        for label in marker.labels:
            place = (round(label.place[0]), round(label.place[1]))
            cv2.putText(image, label.text, place, _FONT, _LABEL_SIZE, GREEN, 1, cv2.LINE_AA)
        colour = GREEN if marker.crosses or marker.curves else _MISSED_COLOUR
        place = (8, image.shape[0] - 10)
        cv2.putText(image, marker.text, place, _FONT, _TEXT_SIZE, colour, 1, cv2.LINE_AA)
        return Picture(image, frame.stamp_ns)


def _cross(image: Image, centre: tuple[float, float]) -> None:
    """Draw an open cross, exact to a sixteenth of a pixel."""
    middle = np.array(centre)
    for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        _curve(image, middle + np.outer(_ARM_PX, way), GREEN)


def _curve(image: Image, places: Array, colour: Colour) -> None:
    """Draw a line through places, exact to a sixteenth of a pixel; a line beyond all bounds is not drawn."""
    if np.all(np.abs(places) < _FARTHEST_PX):  # false for NaN too
        points = np.rint(places * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        cv2.polylines(image, [points], False, colour, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
