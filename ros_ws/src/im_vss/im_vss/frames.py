"""Images on their way from the cameras to the Tools."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class SnapOrder:
    """What to expose: every frame is common to all cameras.

    Attributes:
        cameras: Names of the cameras.
        blank_light: For each frame in turn, whether the wrist lights are strobed off.
        exposure_s: Length of an exposure [s].
        timeout_s: Longest wait for the testbed, wall time [s].
    """

    cameras: tuple[str, ...]
    blank_light: tuple[bool, ...]
    exposure_s: float
    timeout_s: float


@dataclass(frozen=True)
class Frame:
    """One image of one camera.

    Attributes:
        camera: Name of the camera.
        image: Pixels, shape (h, w) [DN].
        stamp_ns: Testbed time of the middle of the exposure [ns].
        blank_light: Whether the wrist lights were strobed off.
    """

    camera: str
    image: Image
    stamp_ns: int
    blank_light: bool


@dataclass(frozen=True)
class FrameSet:
    """What a :class:`SnapOrder` brought.

    Attributes:
        frames: Images of each camera in the order of the exposures.
        timing: Where the time went, by step [s].
    """

    frames: dict[str, tuple[Frame, ...]]
    timing: dict[str, float]


class FrameSource(Protocol):
    """The cameras, as far as a Vision Module sees them."""

    def take(self, order: SnapOrder) -> FrameSet:
        """Expose and read out.

        Raises:
            ImError: The cameras cannot deliver; the message says who is missing.
        """


class Screen(Protocol):
    """The monitors and image outputs."""

    def raw(self, frame: Frame) -> None:
        """Put out an image as it was taken."""

    def display(self, camera: str, image: Image, stamp_ns: int) -> None:
        """Show an image, shape (h, w, 3), red-green-blue [DN]."""
