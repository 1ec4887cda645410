"""Base of all Vision Modules."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar, TypeVar

from im_core.errors import WaitTimeoutError
from im_vss.managers.vmm import Lease
from im_vss.rig import Rig

Result = TypeVar("Result")


class VisionModule:
    """One piece of vision hardware.

    All that touches the hardware runs in the module's only thread, in turn, and only for the holder of a lease; so two
    processes can never be in it, whatever their clients do.
    """

    name: ClassVar[str]

    def __init__(self, rig: Rig) -> None:
        """Attach to the hardware of `rig`."""
        self.rig = rig
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=self.name)

    def run(self, lease: Lease, work: Callable[[], Result]) -> Result:
        """Run `work` on the hardware and hand its result straight to the Tool that holds the lease.

        Raises:
            StateError: The lease is not, or no longer, one for this module.
            WaitTimeoutError: The lease ended before the work did.
            ImError: As raised by `work`.
        """

        def guarded() -> Result:
            lease.check(self.name)
            return work()

        lease.check(self.name)
        future = self._thread.submit(guarded)
        try:
            return future.result(timeout=lease.remaining())
        except TimeoutError:
            future.cancel()
            raise WaitTimeoutError(what=f"{self.name}, used by {lease.client.name}", seconds=lease.hold_s) from None

    def close(self) -> None:
        """Let the work in hand end, take no more."""
        self._thread.shutdown(wait=False, cancel_futures=True)
