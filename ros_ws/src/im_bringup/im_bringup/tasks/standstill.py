"""Detection of a hanging process, from reports on the loop and from the kernel's data."""

from im_core.processes.loop_heartbeat import Pulse
from im_core.processes.procfs import cpu_of

#: How often the CPU time of a process that does not tick is looked at [s].
_LOOK_S = 1.0


class Standstill:
    """Judges one process.

    Two things make a hang, and neither is time that has merely passed: the thread beside the loop has counted that it
    stood still for longer than it may; or that thread has not come to its turn while the process computed for twice
    as long, for something holds the interpreter. A process that is stopped, or waits for a processor, does neither.
    """

    def __init__(self, pid: int, pulse: Pulse) -> None:
        self._pid, self._pulse = pid, pulse
        self._ticks, self._cpu_s, self._look_at = 0, 0.0, 0.0

    def found(self, now: float) -> str:
        """Return why the process counts as hung, as a clause; empty if not hung.

        Args:
            now: Monotonic time [s].
        """
        beat = self._pulse.last()
        if beat.ticks and beat.standing_s >= beat.allowed_s:
            return f"its loop stood still for {beat.standing_s:.1f} s"
        if now < self._look_at:
            return ""
        self._look_at = now + _LOOK_S
        cpu_s = cpu_of(self._pid)
        if not beat.ticks or beat.ticks != self._ticks:
            self._ticks, self._cpu_s = beat.ticks, cpu_s
        elif cpu_s - self._cpu_s >= 2.0 * beat.allowed_s:
            return f"its interpreter was held while it computed for {cpu_s - self._cpu_s:.1f} s"
        return ""
