"""Images on their way from the cameras to the Tools."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_vss.spot.noise import SensorNoise

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class SensorControls:
    """What can be set at a camera, relative to its data sheet: amplification and read noise [-]."""

    gain: float = 1.0
    noise: float = 1.0

    def of(self, sheet: SensorNoise) -> SensorNoise:
        """The sensor of a data sheet with these controls."""
        return sheet.model_copy(update={"gain": sheet.gain / self.gain, "read_noise": sheet.read_noise * self.noise})


@dataclass(frozen=True)
class SnapOrder:
    """What to expose: every frame is common to all cameras.

    Attributes:
        cameras: Names of the cameras.
        blank_light: For each frame in turn, whether the wrist lights are strobed off.
        exposure_s: Length of an exposure [s].
        timeout_s: Longest wait for the testbed, wall time [s].
        controls: Controls of each camera; those of the data sheet where a camera is left out.
        blank_laser: For each frame in turn, whether the laser is strobed off; empty: in none.
    """

    cameras: tuple[str, ...]
    blank_light: tuple[bool, ...]
    exposure_s: float
    timeout_s: float
    controls: dict[str, SensorControls] = field(default_factory=dict)
    blank_laser: tuple[bool, ...] = ()

    @property
    def strobes(self) -> tuple[tuple[bool, bool], ...]:
        """For each frame, whether lights and laser are strobed off."""
        return tuple(zip(self.blank_light, self.blank_laser or (False,) * len(self.blank_light), strict=True))


@dataclass(frozen=True)
class Frame:
    """One image of one camera.

    Attributes:
        camera: Name of the camera.
        image: Pixels, shape (h, w) [DN].
        stamp_ns: Testbed time of the middle of the exposure [ns].
        blank_light: Whether the wrist lights were strobed off.
        controls: How the sensor was set.
    """

    camera: str
    image: Image
    stamp_ns: int
    blank_light: bool
    controls: SensorControls = SensorControls()


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
