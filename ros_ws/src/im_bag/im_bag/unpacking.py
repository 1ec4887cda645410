"""Limits for the unpacking of compressed bags: one kilobyte may stand for a gigabyte of zeros.

``rosbags`` unpacks a chunk, a message or a file whole and looks at its size afterwards. What it unpacks with is
replaced here, once and for all its readers in this process.
"""

import io
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import lz4.frame
from rosbags.rosbag2 import reader, storage_mcap

from im_core.files import MEBIBYTE, FileError

#: Most that a chunk or a message may unpack to, and all files of a bag together [bytes].
LARGEST_PIECE = 256 * MEBIBYTE
LARGEST_BAG = 4096 * MEBIBYTE
_STEP = 4 * MEBIBYTE

_zstd: Any = vars(reader)["zstd"]  # the module, by whatever name this Python has it


class UnpackingError(ValueError):
    """Error: unpacking gives more data than allowed."""


def install() -> None:
    """Have ``rosbags`` unpack within the limits; again and again changes nothing."""
    vars(reader)["zstd"] = SimpleNamespace(open=_zstd.open, decompress=unpack_zstd)
    storage_mcap.DECOMPRESSORS["zstd"] = unpack_zstd
    storage_mcap.DECOMPRESSORS["lz4"] = lambda data, size: _bounded(lz4.frame.open(io.BytesIO(data)), size)


def unpack_zstd(data: bytes, size: int | None = None) -> bytes:
    """Unpack a message or a chunk.

    Args:
        data: Packed.
        size: How large its header says that it is [bytes]; None: it does not say.

    Raises:
        UnpackingError: It is larger than that, or than anything may be.
    """
    return _bounded(_zstd.open(io.BytesIO(data), "rb"), size)


def check_files(bag: Path, paths: Iterable[Path]) -> None:
    """Refuse a bag with files too large after unpacking, each packed as a whole; no unpacked data are kept.

    Args:
        bag: The bag, for the message.
        paths: Its packed files.

    Raises:
        FileError: They do.
        OSError: One cannot be read, or is not packed.
    """
    total = 0
    for path in paths:
        with _zstd.open(path, "rb") as file:
            while part := file.read(_STEP):
                total += len(part)
                if total > LARGEST_BAG:
                    raise FileError(bag, f"unpacks to more than {LARGEST_BAG / MEBIBYTE:g} MiB, which is the limit")


def _bounded(file: BinaryIO, size: int | None) -> bytes:
    largest = LARGEST_PIECE if size is None else min(size, LARGEST_PIECE)
    with file:
        data = file.read(largest + 1)
    if len(data) > largest:
        told = f"the {size} bytes that it announces" if size == largest else f"{largest / MEBIBYTE:g} MiB"
        raise UnpackingError(f"a compressed part of it unpacks to more than {told}")
    return data
