"""Silence of awaited processes, without the time a busy computer gave no processor."""

import math
from collections.abc import Iterable

from im_core import clock
from im_core.processes.procfs import Scheduled, scheduled, stat_fields

#: Most that counts between two looks of the patient [s].
_LONGEST_LOOK_S = 0.1


class Silence:
    """Silence of a process of the host: time with a possible but missing answer.

    A process that is dead, stopped, asleep or that computes is silent; one that wants a processor and gets none is
    not.

    Attributes:
        seconds: Silence up to the last look [s].

    Args:
        pid: Process that is waited for; its main thread is the one that answers.
        seconds: Silence so far [s].
        longest_look_s: Most that counts between two looks [s]: who did not run itself does not blame another.
    """

    def __init__(self, pid: int, seconds: float = 0.0, longest_look_s: float = math.inf) -> None:
        self.seconds = seconds
        self._pid, self._longest = pid, longest_look_s
        self._looked, self._scheduled = clock.monotonic(), scheduled(pid)

    def look(self) -> float:
        """Count the time since the last look, and return the silence in all [s]."""
        now, told = clock.monotonic(), scheduled(self._pid)
        passed = min(now - self._looked, self._longest)
        self.seconds += max(0.0, passed - self._starved(passed, told))
        self._looked, self._scheduled = now, told
        return self.seconds

    def _starved(self, passed: float, told: Scheduled | None) -> float:
        """For how much of the time since the last look the process wanted a processor and had none [s]."""
        before = self._scheduled
        if told is None or before is None:
            return 0.0
        return passed if told.ran_s == before.ran_s and self._wants_processor() else told.queued_s - before.queued_s

    def _wants_processor(self) -> bool:
        fields = stat_fields(self._pid)
        return fields is not None and fields[0] == "R"


class Patience:
    """Time available so far to processes asked to end; on a busy computer, waits for a processor do not count.

    Time in which one of them wants a processor and gets none does not count for any: they may wait for each other.

    Attributes:
        seconds: Up to the last look [s].

    Args:
        pids: The processes; one that has ended holds up nothing.
    """

    def __init__(self, pids: Iterable[int]) -> None:
        self.seconds = 0.0
        self._silences = [Silence(pid, longest_look_s=_LONGEST_LOOK_S) for pid in pids]

    def look(self) -> float:
        """Count the time since the last look, and return the total [s]; infinite without any process."""
        before = [silence.seconds for silence in self._silences]
        passed = [silence.look() - since for silence, since in zip(self._silences, before, strict=True)]
        self.seconds += min(passed, default=math.inf)
        return self.seconds
