"""Grey images of messages: ``sensor_msgs/Image`` and ``CompressedImage``, from a bag or a topic."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError

Image = NDArray[np.uint8] | NDArray[np.uint16]


class _Encoding(NamedTuple):
    """Pixels of an encoding: bytes of a value, values of a pixel, and the conversion to grey, or the value that is."""

    size: int
    values: int
    conversion: int | None = None
    grey: int = 0


_BAYER = {
    "rggb": cv2.COLOR_BayerRGGB2GRAY,
    "bggr": cv2.COLOR_BayerBGGR2GRAY,
    "gbrg": cv2.COLOR_BayerGBRG2GRAY,
    "grbg": cv2.COLOR_BayerGRBG2GRAY,
}
"""Conversions of mosaics; OpenCV's older names differ: its BG is the RGGB of messages."""
_COLOR = {
    "rgb": (3, cv2.COLOR_RGB2GRAY),
    "bgr": (3, cv2.COLOR_BGR2GRAY),
    "rgba": (4, cv2.COLOR_RGBA2GRAY),
    "bgra": (4, cv2.COLOR_BGRA2GRAY),
}
_ENCODINGS = {
    **{f"{name}{8 * size}": _Encoding(size, 1) for name in ("mono",) for size in (1, 2)},
    **{f"{name}{8 * size}": _Encoding(size, *kind) for name, kind in _COLOR.items() for size in (1, 2)},
    **{f"bayer_{name}{8 * size}": _Encoding(size, 1, code) for name, code in _BAYER.items() for size in (1, 2)},
    "8UC1": _Encoding(1, 1),
    "16UC1": _Encoding(2, 1),
    "8UC3": _Encoding(1, 3, cv2.COLOR_BGR2GRAY),
    "8UC4": _Encoding(1, 4, cv2.COLOR_BGRA2GRAY),
    # luminance in one of two bytes; planes: first all of it
    **{name: _Encoding(1, 2, grey=1) for name in ("yuv422", "uyvy")},
    **{name: _Encoding(1, 2) for name in ("yuv422_yuy2", "yuyv")},
    **{name: _Encoding(1, 1) for name in ("nv21", "nv24")},
}
_DEPTH = "compressedDepth"


def grey_image(message: Any, topic: str) -> Image:
    """Return the grey image of a message.

    Args:
        message: ``sensor_msgs/Image`` or ``sensor_msgs/CompressedImage``, of ROS or of ``rosbags``.
        topic: Where it was sent, for errors.

    Returns:
        Image of 8 or 16 bits, shape (height, width).

    Raises:
        DataError: The encoding is not known, or the data are no image of it.
    """
    return _decompressed(message, topic) if hasattr(message, "format") else _raw(message, topic)


def _raw(message: Any, topic: str) -> Image:
    encoding = _ENCODINGS.get(message.encoding)
    if encoding is None:
        known = ", ".join(sorted(_ENCODINGS))
        raise DataError(f"{topic}: images are of encoding '{message.encoding}'; known are {known}.", topic=topic)
    data, height, width = np.frombuffer(message.data, np.uint8), int(message.height), int(message.width)
    row = width * encoding.values * encoding.size
    step = int(message.step) or row
    if min(height, width) < 1 or step < row or len(data) < step * (height - 1) + row:
        raise DataError(
            f"{topic}: an image of {width} x {height} px, {message.encoding}, has {len(data)} bytes in rows of {step}.",
            topic=topic,
        )
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1))
    values: NDArray[np.integer[Any]] = np.ascontiguousarray(rows)
    if encoding.size > 1:
        values = values.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    pixels = values if encoding.values == 1 else values.reshape(height, width, encoding.values)
    if encoding.conversion is not None:
        return _grey(cv2.cvtColor(pixels, encoding.conversion))
    return _grey(pixels if encoding.values == 1 else pixels[..., encoding.grey])


def _decompressed(message: Any, topic: str) -> Image:
    """Return the image of a JPEG or PNG; a grey one of a Bayer sensor is a mosaic."""
    if _DEPTH in message.format:
        raise DataError(
            f"{topic}: has images of depth ({message.format}); those of the camera are needed.", topic=topic
        )
    data = np.frombuffer(message.data, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        told = message.format or "without a name"
        raise DataError(f"{topic}: an image of format '{told}' cannot be read; JPEG and PNG can.", topic=topic)
    if image.ndim == 3:
        return _grey(cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY if image.shape[2] == 4 else cv2.COLOR_BGR2GRAY))
    encoding = _ENCODINGS.get(message.format.partition(";")[0].strip())
    if encoding is None or encoding.values > 1 or encoding.conversion is None:
        return _grey(image)
    return _grey(cv2.cvtColor(image, encoding.conversion))


def _grey(image: Any) -> Image:
    grey = np.ascontiguousarray(image)
    return np.asarray(grey, dtype=np.uint8) if grey.dtype == np.uint8 else np.asarray(grey, dtype=np.uint16)
