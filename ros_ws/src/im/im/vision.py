"""Cameras of the machine: images, and spots of light."""

import struct
import zlib
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im.connection import Connection
from im.errors import MachineError, require
from im_msgs.srv import Snap, SpotFind, SpotFindStereo


class Picture(np.ndarray[Any, np.dtype[np.uint8]]):
    """Image of a camera, shape (h, w); a notebook shows it.

    Attributes:
        stamp: Testbed time of the middle of the exposure [s].
    """

    stamp: float

    def __new__(cls, pixels: ArrayLike, stamp: float) -> Self:
        """Make an image of pixels."""
        image = np.asarray(pixels, dtype=np.uint8).view(cls)
        image.stamp = stamp
        return image

    def __array_finalize__(self, source: Any) -> None:
        """Keep the stamp for views."""
        self.stamp = getattr(source, "stamp", float("nan"))

    def _repr_png_(self) -> bytes | None:
        if self.ndim != 2:
            return None
        rows = np.hstack([np.zeros((self.shape[0], 1), np.uint8), np.asarray(self)])
        head = struct.pack(">2I5B", self.shape[1], self.shape[0], 8, 0, 0, 0, 0)
        chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b""))
        return b"\x89PNG\r\n\x1a\n" + b"".join(
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
            for kind, data in chunks
        )


@dataclass(frozen=True, eq=False)
class Spot:
    """Spot of light in an image.

    Attributes:
        camera: Name of the camera.
        uv: Column and row from the centre of the upper left pixel, shape (2,) [px].
        covariance: Of ``uv``, shape (2, 2) [px^2].
        snr: Strongest response of the matched filter over its noise.
    """

    camera: str
    uv: NDArray[np.float64]
    covariance: NDArray[np.float64]
    snr: float


@dataclass(frozen=True, eq=False)
class Position:
    """Position of the light, seen by two cameras.

    Attributes:
        xyz: In the world, shape (3,) [m].
        covariance: Shape (3, 3) [m^2].
        spots: The spots by camera.
    """

    xyz: NDArray[np.float64]
    covariance: NDArray[np.float64]
    spots: dict[str, Spot]


class Camera:
    """Camera of the machine."""

    def __init__(self, connection: Connection, name: str) -> None:
        self.name = name
        self._connection = connection

    def snap(self, exposure: float = 0.0) -> Picture:
        """Take an image.

        Args:
            exposure: Time of exposure [s]; 0: the one of ``/vss``.

        Raises:
            MachineError: There is no such camera, or it took no image.
        """
        answer = _ask(self._connection, Snap, "/vss/snap", [self.name], exposure)
        image = answer.images[0]
        pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[:, : image.width]
        return Picture(pixels, image.header.stamp.sec + 1e-9 * image.header.stamp.nanosec)

    def spot(self, exposure: float = 0.0) -> Spot:
        """Find the light in an image taken now.

        Args:
            exposure: Time of exposure [s]; 0: the one of ``/vss``.

        Raises:
            MachineError: No spot was found, of code ``not_found``, or the image was not taken.
        """
        answer = _ask(self._connection, SpotFind, "/vss/spot_find", [self.name], exposure)
        spot = answer.spots[0]
        if not spot.found:
            raise MachineError(f"{self.name} sees no spot: {spot.cause}", "not_found", {"camera": self.name})
        return _spot(spot)


def stereo(connection: Connection, first: str, second: str, exposure: float = 0.0) -> Position:
    """Find the light with two cameras exposed at the same time.

    Raises:
        MachineError: No point was found, of code ``not_found``, or an image was not taken.
    """
    answer = _ask(connection, SpotFindStereo, "/vss/spot_find_stereo", [first, second], exposure)
    if not answer.found:
        raise MachineError(f"{first} and {second} see no point: {answer.cause}", "not_found")
    p = answer.point.point
    covariance = np.array(answer.covariance).reshape(3, 3)
    return Position(np.array([p.x, p.y, p.z]), covariance, {spot.camera: _spot(spot) for spot in answer.spots})


def _spot(message: Any) -> Spot:
    covariance = np.array(message.covariance).reshape(2, 2)
    return Spot(message.camera, np.array([message.u, message.v]), covariance, float(message.snr))


def _ask(connection: Connection, kind: Any, service: str, cameras: list[str], exposure: float) -> Any:
    return require(connection.call(kind, service, cameras=cameras, exposure=exposure))
