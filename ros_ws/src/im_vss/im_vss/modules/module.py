"""Base of all Vision Modules."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import ClassVar, TypeVar

from im_core import clock
from im_core.errors import WaitTimeoutError
from im_core.processes.procfs import scheduled, threads_queued_s
from im_vss.managers.vmm import Lease
from im_vss.rig import Rig

Result = TypeVar("Result")
_SLICE_S = 0.2
#: Work that computes is given up after so many times its lease, for whatever reason it does not run.
_MOST_SPARED = 20.0


class VisionModule:
    """One piece of vision hardware.

    All that touches the hardware runs in the module's only thread, in turn, and only for the holder of a lease; so two
    processes can never be in it, whatever their clients do.
    """

    name: ClassVar[str]
    #: Whether its work waits for nothing: then a lease is counted in the processor time of its thread.
    computes: ClassVar[bool] = False

    def __init__(self, rig: Rig) -> None:
        """Attach to the hardware of `rig`."""
        self.rig = rig
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=self.name)

    def run(self, lease: Lease, work: Callable[[], Result]) -> Result:
        """Run `work` on the hardware and hand the result straight to the Tool with the lease.

        Raises:
            StateError: The lease is not, or no longer, one for this module; or its client gave up meanwhile.
            WaitTimeoutError: The lease ended before the work did.
            ImError: As raised by `work`.
        """

        def guarded() -> Result:
            lease.check(self.name)
            if self.computes:
                lease.spared = _without_processor(_MOST_SPARED * lease.hold_s)
            return work()

        lease.check(self.name)
        future = self._thread.submit(guarded)
        try:
            while not future.done() and (left_s := lease.remaining()):
                lease.client.check()
                wait([future], min(left_s, _SLICE_S))
            lease.client.check()
            if future.done():
                return future.result()
        finally:
            future.cancel()
        raise WaitTimeoutError(what=f"{self.name}, used by {lease.client.name}", seconds=lease.hold_s)

    def close(self) -> None:
        """Let the work in hand end, take no more."""
        self._thread.shutdown(wait=False, cancel_futures=True)


def _without_processor(most_s: float) -> Callable[[], float]:
    """Return a function for the time the calling thread has waited for a processor from now on, at most [s].

    For one itself, or for another thread of the process that waited for one and had what it needs: the interpreter.
    Who waits for anything else, as for what will never come, has no time spared.
    """
    pid, thread = os.getpid(), threading.get_native_id()
    began, before, queued_s = clock.monotonic(), scheduled(pid, thread), threads_queued_s(pid)

    def elapsed() -> float:
        now = scheduled(pid, thread)
        if before is None or now is None:
            return 0.0
        idle_s = clock.monotonic() - began - (now.ran_s - before.ran_s)
        return min(most_s, max(0.0, idle_s), max(0.0, threads_queued_s(pid) - queued_s))

    return elapsed
