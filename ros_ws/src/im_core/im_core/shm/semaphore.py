"""Named semaphores (the paper's inter-processor blocking)."""

from pathlib import Path
from typing import Self

import posix_ipc

from im_core import clock
from im_core.errors import LinkError
from im_core.ownership import require_own
from im_core.shm_names import SHM

_POLL_S = 0.01


class Semaphore:
    """Counter shared by processes: :meth:`post` increments, :meth:`wait` waits until a decrement is possible."""

    def __init__(self, name: str, semaphore: posix_ipc.Semaphore, owned: bool) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.name = name
        self.owned = owned
        self._semaphore = semaphore

    @classmethod
    def create(cls, name: str) -> Self:
        """Create a semaphore of value 0; a semaphore of the same name is replaced.

        Raises:
            LinkError: It is another user's.
        """
        require_own(_path(name))
        _unlink(name)
        try:
            made = posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o600, initial_value=0)
        except posix_ipc.ExistentialError as error:  # since it was unlinked
            raise LinkError(f"semaphore '{name}' is made by another process, too", name=name) from error
        return cls(name, made, owned=True)

    @classmethod
    def attach(cls, name: str, timeout_s: float) -> Self:
        """Attach to a semaphore.

        Raises:
            LinkError: No such semaphore appeared within ``timeout_s`` [s], or it is another user's.
        """
        deadline = clock.monotonic() + timeout_s
        while (opened := _open(name)) is None:
            if clock.monotonic() >= deadline:
                raise LinkError(
                    f"semaphore '{name}' does not exist (waited {timeout_s:g} s)", name=name, seconds=timeout_s
                )
            clock.sleep(_POLL_S)
        return cls(name, opened, owned=False)

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
        """Release the semaphore; the owner removes the name."""
        self._semaphore.close()
        self.unlink()

    def unlink(self) -> None:
        """Remove the name, as the owner."""
        if self.owned:
            self.owned = False
            _unlink(self.name)


def _path(name: str) -> Path:
    return SHM / f"sem.{name}"


def _open(name: str) -> posix_ipc.Semaphore | None:
    """Open a semaphore of the user, None if there is none.

    Its owner is looked up by name before and after: the same inode, which others may not remove, was opened between.
    """
    before = require_own(_path(name))
    try:
        opened = posix_ipc.Semaphore(f"/{name}")
    except posix_ipc.ExistentialError:
        return None
    except (OSError, posix_ipc.PermissionsError) as error:  # a link, which is not followed
        raise LinkError(f"semaphore '{name}' cannot be opened: {error}", name=name) from error
    if before is None or require_own(_path(name)) != before:
        opened.close()
        return None
    return opened


def _unlink(name: str) -> None:
    try:
        posix_ipc.unlink_semaphore(f"/{name}")
    except posix_ipc.ExistentialError:
        return
