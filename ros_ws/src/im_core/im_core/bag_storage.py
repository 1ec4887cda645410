"""MCAP files as ``rosbags`` reads them, also where the index of a file is not whole.

It finds channels in the summary only, and passes by chunks whose messages have no index; both may be left out of a file
that is whole (https://mcap.dev/spec, "Summary Section", "Message Index").
"""

from collections.abc import Mapping
from typing import Any

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader

#: Type of a channel whose definition is not in the summary.
_UNDEFINED = "__schemaless__"


class WholeMcapReader(McapReader):
    """Reads every message of a file, whatever its index leaves out."""

    def read_index(self) -> None:
        """Read the summary; all of the file where that does not say what there is."""
        super().read_index()
        if self.statistics is not None and len(self.chunks) != self.statistics.chunk_count:
            self.chunks.clear()  # so that the file is read from its beginning
        if not self._is_told():
            for found in (self.schemas, self.channels, self.connections):
                found.clear()
            self.meta_scan()
        for chunk in self.chunks:
            if not chunk.message_index_offsets:
                chunk.channel_count.update(dict.fromkeys(self.channels, 1))  # each may be in it

    def _is_told(self) -> bool:
        """Whether the summary names the channel and the type of every message."""
        if any(channel.schema == _UNDEFINED for channel in self.channels.values()):
            return False
        if self.statistics is None:
            return all(chunk.message_index_offsets for chunk in self.chunks)
        counts = self.statistics.channel_message_counts
        return sum(counts.values()) == self.statistics.message_count and counts.keys() <= self.channels.keys()


class _WholeDirectoryReader(DirectoryReader):
    STORAGE_PLUGINS: Mapping[str, Any] = {**DirectoryReader.STORAGE_PLUGINS, "mcap": WholeMcapReader}


class WholeReader(Reader):
    """Reads bags, folders and files, every message of them."""

    STORAGE_PLUGINS: Mapping[str, Any] = {
        **Reader.STORAGE_PLUGINS,
        "dir": _WholeDirectoryReader,
        ".mcap": WholeMcapReader,
    }
