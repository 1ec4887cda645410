"""The newest versions of objects in memory: recent ones need no read from the disk."""

import threading
from collections import OrderedDict
from collections.abc import Mapping

from im_dom.object_record import ObjectRecord

Version = tuple[ObjectRecord, bytes]

#: What is kept of a version beside its data takes about so many bytes.
RECORD_BYTES = 1024


class ObjectCache:
    """Valid objects in the state on the disk, the last used ones; for any thread.

    Args:
        most: How many bytes they may take; an object of more than a sixteenth of that is not kept.
    """

    def __init__(self, most: int) -> None:
        self._most, self._size = most, 0
        self._versions: OrderedDict[str, Version] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, name: str) -> Version | None:
        """Return an object if cached."""
        with self._lock:
            version = self._versions.get(name)
            if version is not None:
                self._versions.move_to_end(name)
            return version

    def update(self, versions: Mapping[str, Version | None]) -> None:
        """Replace the known states of objects; None: one is invalid, or missing."""
        with self._lock:
            for name, version in versions.items():
                before = self._versions.pop(name, None)
                if before is not None:
                    self._size -= _size(before)
                if version is not None and _size(version) <= self._most // 16:
                    self._versions[name] = version
                    self._size += _size(version)
            while self._size > self._most:
                _, oldest = self._versions.popitem(last=False)
                self._size -= _size(oldest)


def _size(version: Version) -> int:
    return RECORD_BYTES + len(version[1])
