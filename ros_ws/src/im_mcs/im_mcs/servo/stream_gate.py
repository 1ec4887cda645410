"""Gate of streams: a stream ended by others stays ended, against the next message."""

import math

from im_core.errors import ImError, StateError


class StreamGate:
    """Whether a group takes streaming setpoints or torques.

    A stream that was ended by a stop, a cancel or a limit, and not by its sender's silence, is not opened again by one
    who goes on sending: he must first be silent for his lease, or the group be resumed.

    Args:
        group: Its name.
        period_s: Servo period [s].
    """

    def __init__(self, group: str, period_s: float) -> None:
        self._group, self._period_s = group, period_s
        self._owner, self._lease_s = "", 0.0
        self._fault: ImError | None = None
        self._ticks_left = 0

    @property
    def closed(self) -> bool:
        """Whether a sender's silence is still waited for."""
        return self._ticks_left > 0

    def close(self, owner: str, lease_s: float, fault: ImError) -> None:
        """Note an ended stream.

        Args:
            owner: Who sent it.
            lease_s: How long he must now be silent, testbed time [s].
            fault: Why it was ended.
        """
        self._owner, self._lease_s, self._fault = owner, lease_s, fault
        self._ticks_left = math.ceil(lease_s / self._period_s)

    def open(self) -> None:
        """Nobody need be silent any more."""
        self._ticks_left = 0

    def tick(self) -> None:
        """One more tick of silence."""
        if self._ticks_left:
            self._ticks_left -= 1

    def require_open(self, owner: str) -> None:
        """Check whether a message may open or renew a stream; a message of another owner always may.

        Raises:
            StateError: His stream was ended, and he has not been silent since; the silence is counted anew.
        """
        if not self.closed:
            return
        if owner != self._owner:
            self.open()
            return
        assert self._fault is not None
        self.close(self._owner, self._lease_s, self._fault)
        raise StateError(
            f"the stream of group '{self._group}' was ended ({self._fault.message}): send nothing for "
            f"{self._lease_s:g} s, its lease, or resume the group, before you stream again",
            group=self._group,
        )
