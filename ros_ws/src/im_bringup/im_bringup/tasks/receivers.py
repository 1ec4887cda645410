"""Whether a thread of the middleware is stuck in one packet, and the process hears nothing any more."""

from im_core.processes.procfs import cpu_of, thread_name, threads_of, waits_of

#: A thread of the middleware that has not waited for so much CPU time is stuck [s].
STUCK_S = 10.0
#: How often a process is looked at, and how much CPU time it has used before its threads are [s].
_LOOK_S, _LOOK_CPU_S = 1.0, 0.5
#: How the names of the threads of Fast DDS begin.
_PREFIX = "dds."


class Receivers:
    """Judges the threads of Fast DDS in one process.

    A packet of 52 bytes has a reader count to a trillion (docs/security.md). The thread that received it, and all that
    need the same reader, do nothing else any more, but the loop may turn on. A thread that takes packets waits for the
    next one, or for a lock, again and again; the kernel counts that. Neither a stopped process nor a busy computer
    makes a thread compute.
    """

    def __init__(self, pid: int) -> None:
        self._pid, self._look_at, self._cpu_s = pid, 0.0, 0.0
        self._waited: dict[int, tuple[int, float]] = {}  # number of waits of each thread, CPU time when it was new

    def found(self, now: float) -> str:
        """Return the reason to count the process as stuck, as a clause; empty if not stuck.

        Args:
            now: Monotonic time [s].
        """
        if now < self._look_at:
            return ""
        self._look_at = now + _LOOK_S
        cpu_s = cpu_of(self._pid)
        if cpu_s - self._cpu_s < _LOOK_CPU_S:
            return ""
        self._cpu_s, before, self._waited = cpu_s, self._waited, {}
        for thread in threads_of(self._pid):
            name = thread_name(self._pid, thread)
            if not name.startswith(_PREFIX) or (told := waits_of(self._pid, thread)) is None:
                continue
            waits, ran_s = told
            known = before.get(thread)
            self._waited[thread] = known if known is not None and known[0] == waits else (waits, ran_s)
            stuck_s = ran_s - self._waited[thread][1]
            if stuck_s >= STUCK_S:
                return f"its thread {name} computed for {stuck_s:.1f} s in one packet"
        return ""
