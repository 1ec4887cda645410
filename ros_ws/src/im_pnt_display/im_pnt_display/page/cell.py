"""Messages on the cell, as plain data for the page: joints, frames, markers, images and spots.

They may be those of ROS, or those of a bag as ``rosbags`` decodes them.
"""

import base64
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

from im_core.errors import DataError
from im_pnt_display.page.messages import finite

#: Kinds of markers that the page draws, as ``visualization_msgs/msg/Marker`` numbers them.
MARKER_KINDS = {1: "cube", 2: "sphere", 3: "cylinder", 4: "strip", 5: "list", 11: "faces"}
_ADD = 0
MOST_POINTS = 5000
"""Points of a marker."""
LONGEST_TEXT = 200
#: Colour type of PNG, and bytes of a pixel, by encoding.
_PNG = {"mono8": (0, 1), "rgb8": (2, 3)}

Part = tuple[str, object]
"""Name of a part of the cell, and its content; None: it has gone."""


def joints(message: Any) -> Part:
    """Return the positions of joints by name [rad, m].

    Raises:
        ImError: There are not as many positions as names, or a position is no number.
    """
    if len(message.name) != len(message.position):
        raise DataError(f"it has {len(message.name)} joints and {len(message.position)} positions")
    pairs = zip(message.name, message.position, strict=True)
    return "joints", {str(name): finite(name, float(position)) for name, position in pairs}


def frames(message: Any) -> Iterator[Part]:
    """Yield each frame: ``parent``, ``xyz`` [m] and ``quaternion`` (x, y, z, w).

    Raises:
        ImError: A number of it is none.
    """
    for told in message.transforms:
        place, turn = told.transform.translation, told.transform.rotation
        content = {
            "parent": told.header.frame_id,
            "xyz": _numbers(place.x, place.y, place.z),
            "quaternion": _numbers(turn.x, turn.y, turn.z, turn.w),
        }
        yield f"frame/{told.child_frame_id}", content


def markers(message: Any) -> Iterator[Part]:
    """Yield each marker that the page can draw: kind, frame, text, pose, scale [m], color, points [m].

    Raises:
        ImError: A number of it is none, or it has too many points.
    """
    for told in message.markers:
        name = f"marker/{told.ns}/{told.id}"
        if told.action != _ADD or told.type not in MARKER_KINDS:
            yield name, None
            continue
        if len(told.points) > MOST_POINTS:
            raise DataError(f"marker {told.ns} {told.id} has more than {MOST_POINTS} points")
        place, turn, color = told.pose.position, told.pose.orientation, told.color
        yield (
            name,
            {
                "kind": MARKER_KINDS[told.type],
                "frame": told.header.frame_id,
                "text": told.text[:LONGEST_TEXT],
                "xyz": _numbers(place.x, place.y, place.z),
                "quaternion": _numbers(turn.x, turn.y, turn.z, turn.w),
                "scale": _numbers(told.scale.x, told.scale.y, told.scale.z),
                "color": _numbers(color.r, color.g, color.b, color.a),
                "points": [_numbers(point.x, point.y, point.z) for point in told.points],
            },
        )


def jpeg(camera: str, message: Any) -> Part:
    """Return a compressed image as a data address."""
    return f"image/{camera}", _data("jpeg", bytes(message.data))


def png(camera: str, message: Any) -> Part:
    """Return an image as a data address, packed as PNG.

    Raises:
        DataError: It has another encoding, or not as many bytes as pixels.
    """
    if message.encoding not in _PNG:
        raise DataError(f"its encoding is {message.encoding}; shown are {', '.join(_PNG)}")
    kind, size = _PNG[message.encoding]
    row, data = size * message.width, bytes(message.data)
    if message.step < row or len(data) < message.step * message.height:
        raise DataError(f"its {len(data)} bytes are no {message.width} x {message.height} pixels")
    rows = b"".join(b"\0" + data[at : at + row] for at in range(0, message.step * message.height, message.step))
    head = struct.pack(">IIBBBBB", message.width, message.height, 8, kind, 0, 0, 0)
    chunks = _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows, 1)) + _chunk(b"IEND", b"")
    return f"image/{camera}", _data("png", b"\x89PNG\r\n\x1a\n" + chunks)


def spot(camera: str, message: Any) -> Part:
    """Return the place of the light in the image of a camera [px]; None where it was not found."""
    place = (float(message.point.x), float(message.point.y))
    return f"spot/{camera}", place if all(map(math.isfinite, place)) else None


def _data(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG file (ISO/IEC 15948)."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _numbers(*values: Any) -> Sequence[float]:
    return [round(finite("place", float(value)), 5) for value in values]
