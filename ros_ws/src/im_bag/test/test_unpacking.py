"""A bag that is compressed unpacks to no more than it may, whatever it is compressed with."""

import io
import tracemalloc

import lz4.frame
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, storage_mcap
from rosbags.typesys import Stores, get_typestore

from im_bag import unpacking
from im_bag.reading import messages_of
from im_core.errors import DataError
from im_core.files import MEBIBYTE

BOMB_MIB = 64
TYPE = "std_msgs/msg/String"
STORE = get_typestore(Stores.ROS2_JAZZY)


def bag_of(folder, mode, plugin, mib):
    """A bag with one text of so many zeros."""
    writer = Writer(folder, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/text", TYPE, typestore=STORE)
        text = STORE.types[TYPE](data="0" * round(mib * MEBIBYTE))
        writer.write(connection, 1, STORE.serialize_cdr(text, TYPE))
    return folder


def read(bag):
    return [len(message.content.data) for message in messages_of(bag, {"/text": (TYPE,)})]


MODES = [
    (CompressionMode.FILE, StoragePlugin.SQLITE3),
    (CompressionMode.MESSAGE, StoragePlugin.SQLITE3),
    (CompressionMode.STORAGE, StoragePlugin.MCAP),
]


@pytest.mark.parametrize(("mode", "plugin"), MODES)
def test_what_unpacks_to_more_than_the_limit_is_refused(tmp_path, monkeypatch, mode, plugin):
    monkeypatch.setattr(unpacking, "LARGEST_PIECE", 2 * MEBIBYTE)
    monkeypatch.setattr(unpacking, "LARGEST_BAG", 2 * MEBIBYTE)
    assert read(bag_of(tmp_path / "small", mode, plugin, 1.0)) == [MEBIBYTE]
    with pytest.raises(DataError, match=r"unpacks to more than 2 MiB"):
        read(bag_of(tmp_path / "bomb", mode, plugin, 4.0))


@pytest.mark.parametrize(("name", "pack"), [("zstd", zstd.compress), ("lz4", lz4.frame.compress)])
def test_a_chunk_unpacks_to_no_more_than_it_announces(name, pack):
    unpack = storage_mcap.DECOMPRESSORS[name]
    packed = pack(bytes(BOMB_MIB * MEBIBYTE))
    assert unpack(pack(b"0123"), 4) == b"0123"
    tracemalloc.start()
    try:
        with pytest.raises(unpacking.UnpackingError, match="more than the 100 bytes that it announces"):
            unpack(packed, 100)
        assert tracemalloc.get_traced_memory()[1] < BOMB_MIB * MEBIBYTE / 4
    finally:
        tracemalloc.stop()


def test_several_frames_one_after_the_other_are_one_message():
    frames = b"".join(map(zstd.compress, (b"01", b"23")))
    assert unpacking.unpack_zstd(frames) == b"0123"
    assert zstd.open(io.BytesIO(frames)).read() == b"0123"
