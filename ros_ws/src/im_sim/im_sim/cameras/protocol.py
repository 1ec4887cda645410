"""Protocol between the camera process and the host: settings, requests, replies, shared memory."""

from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from im_cell.robot import Cell
from im_cell.sensor import SensorControls, SensorNoise
from im_core.config import Model
from im_core.errors import DataError, ImError
from im_core.shm import MessageRing, Semaphore, SharedBlock, SharedRecord

MOST_FRAMES = 4
"""Most exposures of a request."""


class CameraSettings(Model):
    """Settings of the simulated cameras.

    Attributes:
        cameras: Names of those in use.
        sensor: Their data sheet.
        nominal_exposure: Length of the exposure that brightnesses are given for [s].
        renderer: How the scene is rendered; ``auto``: by EGL where its plug-in loads, else by software.
    """

    cameras: tuple[str, ...]
    sensor: SensorNoise
    nominal_exposure: Annotated[float, Field(gt=0.0)]
    renderer: Literal["auto", "egl", "tiny"] = "auto"


@dataclass(frozen=True)
class CameraRequest:
    """An order for the camera process; see :class:`im_cell.frames.SnapOrder`."""

    number: int
    cameras: tuple[str, ...]
    strobes: tuple[tuple[bool, bool], ...]
    exposure_s: float
    timeout_s: float
    controls: dict[str, SensorControls]

    def to_json(self) -> dict[str, Any]:
        """As a message of a ring."""
        return asdict(self)

    @classmethod
    def from_json(cls, message: dict[str, Any]) -> Self:
        """From a message of a ring."""
        fields = {"cameras": tuple(message["cameras"]), "strobes": tuple(map(tuple, message["strobes"]))}
        controls = {camera: SensorControls(**values) for camera, values in message["controls"].items()}
        return cls(**{**message, **fields, "controls": controls})


@dataclass(frozen=True)
class CameraReply:
    """Answer of the camera process; ``number`` 0 is the first message: the process is ready.

    A request is answered twice: when all is exposed, and when the images are there.

    Attributes:
        number: Number of the request.
        stamps_ns: Testbed time of the middle of each exposure [ns].
        timing: Where the time went, by step [s].
        exposure_s: How long each exposure was [s].
        error: Code, message and facts of what went wrong; None if all is well.
        exposed: Whether it says that all is exposed, and nothing else yet.
    """

    number: int
    stamps_ns: tuple[int, ...] = ()
    timing: dict[str, float] | None = None
    exposure_s: float = 0.0
    error: dict[str, Any] | None = None
    exposed: bool = False

    def to_json(self) -> dict[str, Any]:
        """As a message of a ring."""
        return asdict(self)

    @classmethod
    def from_json(cls, message: dict[str, Any]) -> Self:
        """From a message of a ring."""
        return cls(**{**message, "stamps_ns": tuple(message["stamps_ns"])})

    @classmethod
    def failed(cls, number: int, error: ImError) -> Self:
        """Return a reply with an error."""
        facts = {key: value for key, value in error.facts.items() if isinstance(value, str | int | float | bool)}
        return cls(number, error={"code": error.code, "message": error.message, "facts": facts})


def channel_name(instance: str) -> str:
    """Return the name of the channel's memory."""
    return f"{instance}_vss"


class CameraChannel(SharedRecord):
    """Memory of :func:`channel_name` between the host, the creator, and the camera process.

    Attributes:
        requests: Host to camera process.
        replies: Camera process to host.
        requested: Raised with each request.
        replied: Raised with each reply.
    """

    SEMAPHORES = ("requested", "replied")

    @staticmethod
    def layout(cell: Cell) -> np.dtype[np.void]:
        """Return the fields of the channel for all cameras of ``cell``; images by camera, one for each exposure."""
        sizes = {name: (camera.intrinsics.height, camera.intrinsics.width) for name, camera in cell.cameras.items()}
        images = np.dtype([(name, "u1", (MOST_FRAMES, *size)) for name, size in sizes.items()])
        ring = MessageRing.layout()
        return np.dtype([("requests", ring), ("replies", ring), ("images", images)], align=True)

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void], semaphores: list[Semaphore]) -> None:
        super().__init__(block, dtype, semaphores)
        self.requests = MessageRing(self.view["requests"], f"{self.name}_requests")
        self.replies = MessageRing(self.view["replies"], f"{self.name}_replies")
        self.requested, self.replied = semaphores

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        """The image of a camera and exposure as a view of shared memory, shape (h, w) [DN].

        Raises:
            DataError: There is no place for that many exposures.
        """
        if not 0 <= frame < MOST_FRAMES:
            raise DataError(f"exposure {frame} is not one of 0 to {MOST_FRAMES - 1}", frame=frame)
        image: NDArray[np.uint8] = self.view["images"][camera][frame]
        return image
