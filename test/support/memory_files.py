"""Files of a journal in memory, for tests: they outlive processes that are only played, and may fail or be cut off."""

import errno
from random import Random

from im_pnt.errors import JournalError
from im_pnt_node.journal.folder import Growing

#: What a disk writes at once [bytes].
SECTOR = 512


class MemoryFiles:
    """What a journal needs of a file system, in memory.

    Attributes:
        name: Where it is, for messages.
        contents: The files.
        full: Whether nothing more fits.
    """

    class Death(BaseException):
        """The process dies here."""

    def __init__(self, name: str = "memory") -> None:
        self.name = name
        self.contents: dict[str, bytearray] = {}
        self.full = False
        self._locked = False
        self._safe: dict[int, int] = {}
        self._steps: int | None = None
        self._part = 0.5

    def dies_after(self, steps: int, part: float = 0.5) -> None:
        """Has the process die at a step of its writing.

        Args:
            steps: Steps (writes, renames, ...) that are still done.
            part: How much of the next write is still written, 0..1.
        """
        self._steps, self._part = steps, part

    def reborn(self) -> "MemoryFiles":
        """Returns the files as another process finds them."""
        other = self.copy()
        other._steps = None
        return other

    def unplugged(self, draw: Random | None = None) -> "MemoryFiles":
        """Returns the files as another process finds them when the computer has lost its power.

        Args:
            draw: How much of what was not synchronised is there all the same, and which of its sectors are filled;
                None: nothing is.
        """
        other = self.reborn()
        for name, content in self.contents.items():
            safe = self._safe.get(id(content), 0)
            there = other.contents[name]
            del there[safe if draw is None else draw.randint(safe, len(content)) :]
            filled = draw.random() if draw is not None else 1.0
            for sector in range(safe - safe % SECTOR, len(there), SECTOR):
                if draw is not None and draw.random() > filled:
                    begin, end = max(safe, sector), min(sector + SECTOR, len(there))
                    there[begin:end] = bytes(end - begin)
        return other

    def synchronised(self, content: bytearray) -> None:
        """Notes that a file is on the disk as it is now."""
        self._safe[id(content)] = len(content)

    def copy(self) -> "MemoryFiles":
        """Returns files with the same content, which nobody holds."""
        other = MemoryFiles(self.name)
        other.contents = {name: bytearray(content) for name, content in self.contents.items()}
        other._steps, other._part = self._steps, self._part
        return other

    def step(self) -> bool:
        """Counts a step; returns whether the process dies at it."""
        if self._steps is None:
            return False
        self._steps -= 1
        return self._steps < 0

    def written(self, data: bytes) -> int:
        """Returns how much of some data is written before the process dies, or all of it.

        Raises:
            OSError: Nothing fits.
        """
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return int(len(data) * self._part) if self.step() else len(data)

    def lock(self) -> None:
        """Takes the files.

        Raises:
            JournalError: They are taken.
        """
        if self._locked:
            raise JournalError(f"{self.name}: the journal is in use", file=self.name)
        self._locked = True

    def unlock(self) -> None:
        """Gives the files back."""
        self._locked = False

    def names(self) -> list[str]:
        """Returns the names of the files, sorted."""
        return sorted(name for name in self.contents if "/" not in name)

    def read(self, name: str) -> bytes:
        """Returns the content of a file."""
        return bytes(self.contents[name])

    def create(self, name: str) -> Growing:
        """Makes an empty file, in the place of one of that name."""
        self.die_if_due()
        self.contents[name] = bytearray()
        return _MemoryFile(self, self.contents[name])

    def extend(self, name: str, size: int) -> Growing:
        """Opens a file to write behind its first ``size`` bytes; drops what is there."""
        self.die_if_due()
        del self.contents[name][size:]
        return _MemoryFile(self, self.contents[name])

    def rename(self, name: str, new: str) -> None:
        """Renames a file."""
        self.die_if_due()
        self.contents[new] = self.contents.pop(name)

    def remove(self, name: str) -> None:
        """Removes a file."""
        self.die_if_due()
        self.contents.pop(name, None)

    def move_aside(self, names: list[str], folder: str) -> None:
        """Moves files into a folder inside this one."""
        for name in names:
            self.contents[f"{folder}/{name}"] = self.contents.pop(name)

    def die_if_due(self) -> None:
        """Dies, if this step is the one.

        Raises:
            Death: It is.
        """
        if self.step():
            raise self.Death


class _MemoryFile:
    def __init__(self, files: MemoryFiles, content: bytearray) -> None:
        self._files, self._content = files, content

    def write(self, data: bytes) -> None:
        size = self._files.written(data)
        self._content.extend(data[:size])
        if size < len(data):
            raise self._files.Death

    def sync(self) -> None:
        self._files.die_if_due()
        self._files.synchronised(self._content)

    def close(self) -> None:
        pass
