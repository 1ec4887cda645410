"""The newest versions of objects in memory: what was read or written lately need not be read from the disk."""

import threading
from collections import OrderedDict
from collections.abc import Mapping

from im_dom.object_record import ObjectRecord

Version = tuple[ObjectRecord, bytes]

#: What is kept of a version beside its data takes about so many bytes.
RECORD_BYTES = 1024


class ObjectCache:
    """Valid objects as they are on the disk, those that were used last; for any thread.

    Args:
        most: How many bytes they may take; an object of more than a sixteenth of that is not kept.
    """

    def __init__(self, most: int) -> None:
        self._most, self._size = most, 0
        self._versions: OrderedDict[str, Version] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, name: str) -> Version | None:
        """An object, if it is here."""
        with self._lock:
            version = self._versions.get(name)
            if version is not None:
                self._versions.move_to_end(name)
            return version

    def update(self, versions: Mapping[str, Version | None]) -> None:
        """Takes objects in place of what was known of them; None: one is not valid any more, or not there."""
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
