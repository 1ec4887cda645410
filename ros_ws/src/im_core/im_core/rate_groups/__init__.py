"""Synchronisation service (paper, section 3): functions at fixed multiples of one period, in a fixed order.

| to learn | open |
|---|---|
| when which function is called, and what becomes of missed calls | :mod:`.groups` |
| how a loop keeps its deadlines, or runs as fast as it can | :mod:`.loop`, :mod:`.pacer` |
| how a function that takes too long is ended | :mod:`.budget` |
"""

from im_core.rate_groups.groups import LATENESS_S, Overrun, RateGroups, RateStatistics, rate_fault
from im_core.rate_groups.loop import RateLoop

__all__ = ["LATENESS_S", "Overrun", "RateGroups", "RateLoop", "RateStatistics", "rate_fault"]
