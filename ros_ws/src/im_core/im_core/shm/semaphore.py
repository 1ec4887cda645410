"""Named semaphores (the paper's inter-processor blocking)."""

from typing import Self

import posix_ipc

from im_core import clock
from im_core.errors import LinkError
from im_core.shm.ownership import own_names

_KIND = "semaphore"

_POLL_S = 0.01


class Semaphore:
    """A counter shared by processes: :meth:`post` raises it, :meth:`wait` waits until it can lower it."""

    def __init__(self, name: str, semaphore: posix_ipc.Semaphore, owned: bool) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.name = name
        self.owned = owned
        self._semaphore = semaphore

    @classmethod
    def create(cls, name: str) -> Self:
        """Create a semaphore of value 0; one of that name is replaced.

        Raises:
            LinkError: It is another user's.
        """
        with own_names(_KIND, name):
            _unlink(name)
            made = posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o600, initial_value=0)
        return cls(name, made, owned=True)

    @classmethod
    def attach(cls, name: str, timeout_s: float) -> Self:
        """Attach to a semaphore.

        Raises:
            LinkError: No such semaphore appeared within ``timeout_s`` [s], or it is another user's.
        """
        deadline = clock.monotonic() + timeout_s
        while True:
            try:
                with own_names(_KIND, name):
                    return cls(name, posix_ipc.Semaphore(f"/{name}"), owned=False)
            except posix_ipc.ExistentialError:
                if clock.monotonic() >= deadline:
                    raise LinkError(
                        f"semaphore '{name}' does not exist (waited {timeout_s:g} s)", name=name, seconds=timeout_s
                    ) from None
                clock.sleep(_POLL_S)

    def post(self) -> None:
        """Raise the counter by one."""
        self._semaphore.release()

    def wait(self, timeout_s: float) -> bool:
        """Lower the counter by one, waiting for at most ``timeout_s`` [s]; False if the time ran out."""
        try:
            self._semaphore.acquire(timeout_s)
        except (posix_ipc.BusyError, posix_ipc.SignalError):
            return False
        return True

    def drain(self) -> None:
        """Lower the counter to zero without waiting."""
        while self._semaphore.value and self.wait(0):
            continue

    def close(self) -> None:
        """Release the semaphore; its owner removes the name."""
        self._semaphore.close()
        self.unlink()

    def unlink(self) -> None:
        """Remove the name, as its owner."""
        if self.owned:
            self.owned = False
            _unlink(self.name)


def _unlink(name: str) -> None:
    try:
        posix_ipc.unlink_semaphore(f"/{name}")
    except posix_ipc.ExistentialError:
        return
