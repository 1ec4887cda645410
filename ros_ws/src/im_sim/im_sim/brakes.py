"""Brakes: springs hold after a delay, coils let go."""

import numpy as np
from numpy.typing import NDArray


class HoldingBrakes:
    """Brakes with a stated delay to hold, or let go, after the command: springs and coils take the time.

    Args:
        n: Number of joints.
        delay_ticks: Ticks from a command until a brake obeys.

    Attributes:
        engaged: Which brakes hold, shape (n,); another array after every change.
    """

    def __init__(self, n: int, delay_ticks: int) -> None:
        self.engaged = np.ones(n, dtype=np.bool_)
        self._delay_ticks = delay_ticks
        self._waited = np.zeros(n, dtype=np.intp)
        self._agreed = self.engaged.tobytes()

    @property
    def obey(self) -> bool:
        """Whether every brake is in the commanded state."""
        return self._agreed != b""

    def tick(self, commanded: NDArray[np.bool_]) -> None:
        """Let a tick pass under a command, shape (n,); a command taken back starts the delay anew."""
        if commanded.tobytes() == self._agreed:
            return
        self._waited = np.where(commanded != self.engaged, self._waited + 1, 0)
        self.engaged = np.where(self._waited > self._delay_ticks, commanded, self.engaged)
        differ = commanded != self.engaged
        self._waited *= differ
        self._agreed = b"" if differ.any() else commanded.tobytes()
