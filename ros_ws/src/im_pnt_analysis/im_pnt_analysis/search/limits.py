"""Limits of a search, without numpy, for readers of a finished one."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """Where a search gives up.

    Attributes:
        states: Number of markings.
        seconds: CPU time for everything [s].
        memory: Memory for what explicit search stores [bytes].
    """

    states: int = 200_000
    seconds: float = 30.0
    memory: int = 2 << 30
