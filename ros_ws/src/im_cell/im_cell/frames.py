"""Images and image sources: orders for exposures, the resulting frames, and the contract of a frame source."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_cell.sensor import SensorControls, SensorNoise

Image = NDArray[np.uint8]

Exposed = Callable[[tuple[int, ...]], None]
"""Is told the testbed times of the middle of each exposure [ns], when the last shutter has closed."""


def nobody(stamps_ns: tuple[int, ...]) -> None:
    """Ignore the shutter times."""


@dataclass(frozen=True)
class SnapOrder:
    """Order of exposures: every frame is common to all cameras.

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
    controls: SensorControls = field(default_factory=SensorControls)


@dataclass(frozen=True)
class FrameSet:
    """Result of a :class:`SnapOrder`.

    Attributes:
        frames: Images of each camera in the order of the exposures.
        timing: Where the time went, by step [s].
        exposure_s: How long each exposure was [s]; what was ordered, as nearly as the cameras can.
    """

    frames: dict[str, tuple[Frame, ...]]
    timing: dict[str, float]
    exposure_s: float


@dataclass(frozen=True)
class FrameSourceSetup:
    """Setup given to a frame source at creation.

    Attributes:
        cell: Where the cameras are and what sizes their images have.
        cameras: Names of the cameras in use.
        sensor: Their data sheet.
        nominal_exposure_s: Usual length of an exposure [s].
        start_timeout_s: How long it may take until the cameras are ready [s].
        settings: Settings of the source's own, as written in ``vss.yaml``.
        node: The ROS node of VSS, for a source of topics.
    """

    cell: Cell
    cameras: tuple[str, ...]
    sensor: SensorNoise
    nominal_exposure_s: float
    start_timeout_s: float
    settings: Mapping[str, object]
    node: Any = None


class FrameSource(ABC):
    """Source of the images of all cameras, one order at a time; ``vss.yaml`` names the class."""

    @classmethod  # noqa: B027  # most have no processes
    def prepare(cls) -> None:
        """Prepare modules for the child processes (:func:`im_core.processes.process.prepare`), before ROS is loaded."""

    @abstractmethod
    def __init__(self, setup: FrameSourceSetup) -> None: ...

    @abstractmethod
    def start(self) -> None:
        """Begin to get ready; :meth:`wait_ready` waits for readiness.

        Raises:
            ImError: The cameras cannot be had.
        """

    @abstractmethod
    def wait_ready(self) -> None:
        """Wait until images can be taken.

        Raises:
            ImError: The cameras do not become ready, or not in time.
        """

    @abstractmethod
    def revive(self) -> str:
        """Restart dead parts; return the cause of death, empty if nothing died."""

    @abstractmethod
    def take_frames(self, order: SnapOrder, exposed: Exposed = nobody) -> FrameSet:
        """Expose and read out.

        Args:
            order: What to expose.
            exposed: Called once, when all is exposed and before it is read out: what moves from then on is in no image.

        Raises:
            ImError: The cameras cannot deliver; the message says who is missing.
        """

    def await_image(self, due_ns: int | None) -> None:  # noqa: B027  # time waits for none where it passes by itself
        """Announce the due time of the next image at a rate; simulated time, where possible, waits for the image.

        Args:
            due_ns: Testbed time [ns]; None: none is.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the cameras."""
