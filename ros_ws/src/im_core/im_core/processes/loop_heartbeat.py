"""Report of a process's loop to the agent, in shared memory: without a lock, a message or a clock."""

import mmap
import os
import struct
from dataclasses import dataclass

#: The environment variable that tells a process the file descriptor of its pulse.
VARIABLE = "IM_PULSE"

_FIELDS = struct.Struct("<Qdd")
_TICKS = struct.Struct("<Q")


@dataclass(frozen=True)
class Beat:
    """How the loop of a process is.

    Attributes:
        ticks: How often that was looked at; 0: not yet.
        standing_s: How long the loop has stood still, of the time in which it could run [s].
        allowed_s: How long it may [s]; infinite: nobody looks now.
    """

    ticks: int
    standing_s: float
    allowed_s: float


class Pulse:
    """Last beat of a process; the memory ends with the sharing processes.

    Args:
        descriptor: Of a file in memory.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _FIELDS.size)

    def keep(self) -> None:
        """Close the file: no other process needs the descriptor, and the memory stays."""
        os.close(self.descriptor)

    @classmethod
    def create(cls) -> "Pulse":
        """Create a new pulse, for a child."""
        descriptor = os.memfd_create("pulse")
        os.ftruncate(descriptor, _FIELDS.size)
        return cls(descriptor)

    @classmethod
    def inherited(cls) -> "Pulse | None":
        """Return the pulse given by the agent to the process, None without one; child processes get none."""
        descriptor = os.environ.pop(VARIABLE, "")
        if not descriptor:
            return None
        pulse = cls(int(descriptor))
        pulse.keep()
        return pulse

    def beat(self, beat: Beat) -> None:
        """Report the state of the loop; a reader meanwhile sees each number old or new, and never a half-written beat.

        ``pack_into`` writes zeros first: a loop that may stand still for 0 s would be read, and count as hung.
        """
        told = _FIELDS.pack(beat.ticks, beat.standing_s, beat.allowed_s)
        self._memory[_TICKS.size :] = told[_TICKS.size :]
        self._memory[: _TICKS.size] = told[: _TICKS.size]

    def last(self) -> Beat:
        """Return the last report."""
        return Beat(*_FIELDS.unpack_from(self._memory, 0))
