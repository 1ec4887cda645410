"""Named shared memory with an owner."""

import mmap
import os
from types import TracebackType
from typing import Any, Self

import numpy as np
import posix_ipc
from numpy.typing import NDArray

from im_core import clock
from im_core.errors import LinkError
from im_core.ownership import check_owner, require_own
from im_core.processes.procfs import ProcessId
from im_core.shm_names import SHM

_MAGIC = 0x696D5F73686D3032
_HEADER = np.dtype([("magic", "<u8"), ("pid", "<i8"), ("start", "<i8"), ("size", "<u8")])
_HEADER_BYTES = 64
_POLL_S = 0.01


class SharedBlock:
    """Bytes shared by several processes under one name.

    The creator owns the block. A block whose owner has died is stale: :meth:`create` replaces it, :meth:`attach`
    waits for its replacement.
    """

    def __init__(self, name: str, memory: mmap.mmap, owned: bool) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.name = name
        self.owned = owned
        self.published = not owned
        self._memory = memory
        header = np.frombuffer(memory, dtype=_HEADER, count=1)[0]
        self._owner = ProcessId(int(header["pid"]), int(header["start"]))
        self.size = int(header["size"])

    @classmethod
    def create(cls, name: str, size: int) -> Self:
        """Create a zeroed block of ``size`` bytes; a stale block of the same name is replaced.

        The block can be attached only after :meth:`publish`, so that nobody sees it half initialised. All its pages
        are there from the beginning: one that had to be found at the first write would end the writer with SIGBUS
        where ``/dev/shm`` has become full.

        Raises:
            LinkError: Another living process, or another user, owns a block of that name, or there is no room for it.
        """
        whole = _HEADER_BYTES + size
        require_own(SHM / name)
        _refuse_if_in_use(name)
        unlink(name)
        try:
            shared = posix_ipc.SharedMemory(f"/{name}", posix_ipc.O_CREX, mode=0o600)
        except posix_ipc.ExistentialError as error:  # since it was unlinked
            raise LinkError(f"shared memory '{name}' is made by another process, too", name=name) from error
        try:
            os.posix_fallocate(shared.fd, 0, whole)
            memory = mmap.mmap(shared.fd, whole)
        except OSError as error:
            unlink(name)
            raise LinkError(
                f"there is no room for the {whole} bytes of the shared memory '{name}': {error.strerror}",
                name=name,
                needed=whole,
            ) from error
        finally:
            shared.close_fd()
        owner = ProcessId.current()
        header = np.frombuffer(memory, dtype=_HEADER, count=1)
        header[0] = (0, owner.pid, owner.start, size)
        return cls(name, memory, owned=True)

    @classmethod
    def attach(cls, name: str, timeout_s: float) -> Self:
        """Attach to a published block with a living owner.

        Args:
            name: Name given by the creator.
            timeout_s: How long to wait for the block to appear [s].

        Raises:
            LinkError: No such block appeared in time, the message says whether a stale one is there; or it is another
                user's.
        """
        deadline = clock.monotonic() + timeout_s
        while True:
            memory, trouble = _open(name)
            if memory is not None:
                return cls(name, memory, owned=False)
            if clock.monotonic() >= deadline:
                raise LinkError(
                    f"shared memory '{name}' {trouble} (waited {timeout_s:g} s)", name=name, seconds=timeout_s
                )
            clock.sleep(_POLL_S)

    def publish(self) -> None:
        """Let others attach."""
        np.frombuffer(self._memory, dtype="<u8", count=1)[0] = _MAGIC
        self.published = True

    def array(self, dtype: np.dtype[np.void] | str, count: int, offset: int = 0) -> NDArray[Any]:
        """Return a view of ``count`` items of ``dtype`` at byte ``offset``."""
        return np.frombuffer(self._memory, dtype=dtype, count=count, offset=_HEADER_BYTES + offset)

    @property
    def owner_pid(self) -> int:
        """Process id of the block's creator."""
        return self._owner.pid

    def owner_alive(self) -> bool:
        """Return whether the process of the block's creator still runs."""
        return self._owner.alive()

    def close(self) -> None:
        """Release the mapping; views in use keep the mapping until released; the owner unlinks the name."""
        if self.owned:
            self.unlink()
        try:
            self._memory.close()
        except BufferError:
            return  # numpy views are alive: the mapping ends with the last of them

    def unlink(self) -> None:
        """Remove the name of an owned block; attached processes keep the memory."""
        if self.owned:
            self.owned = False
            unlink(self.name)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open(name: str) -> tuple[mmap.mmap | None, str]:
    """Map a published block with a living owner, or say why there is none."""
    try:
        require_own(SHM / name)
        shared = posix_ipc.SharedMemory(f"/{name}")
    except posix_ipc.ExistentialError:
        return None, "does not exist"
    except (OSError, posix_ipc.PermissionsError) as error:  # a link, which is not followed
        raise LinkError(f"shared memory '{name}' cannot be opened: {error}", name=name) from error
    try:
        status = os.fstat(shared.fd)
        check_owner(SHM / name, status)
        size = status.st_size
        if size < _HEADER_BYTES:
            return None, "is being created"
        memory = mmap.mmap(shared.fd, size)
    finally:
        shared.close_fd()
    header = np.frombuffer(memory, dtype=_HEADER, count=1)[0]
    if int(header["magic"]) != _MAGIC:
        return None, "is not initialised"
    if not ProcessId(int(header["pid"]), int(header["start"])).alive():
        return None, f"was left behind by process {int(header['pid'])}, which is gone"
    return memory, ""


def dead_owner(name: str) -> int:
    """Find the dead creator of a block left behind; return 0 if there is none.

    Raises:
        LinkError: The block is another user's.
    """
    try:
        require_own(SHM / name)
        shared = posix_ipc.SharedMemory(f"/{name}")
    except posix_ipc.ExistentialError:
        return 0
    except (OSError, posix_ipc.PermissionsError) as error:
        raise LinkError(f"shared memory '{name}' cannot be opened: {error}", name=name) from error
    try:
        head = os.pread(shared.fd, _HEADER.itemsize, 0)
    finally:
        shared.close_fd()
    if len(head) < _HEADER.itemsize:
        return 0
    header = np.frombuffer(head, dtype=_HEADER, count=1)[0]
    owner = ProcessId(int(header["pid"]), int(header["start"]))
    return 0 if owner.alive() else owner.pid


def _refuse_if_in_use(name: str) -> None:
    memory, _ = _open(name)
    if memory is None:
        return
    pid = int(np.frombuffer(memory, dtype=_HEADER, count=1)[0]["pid"])
    if pid != os.getpid():
        raise LinkError(
            f"shared memory '{name}' is in use by process {pid}: "
            "two machines on one host need different values of ROS_DOMAIN_ID",
            name=name,
            pid=pid,
        )


def unlink(name: str) -> None:
    """Remove the name of a block if present."""
    try:
        posix_ipc.unlink_shared_memory(f"/{name}")
    except posix_ipc.ExistentialError:
        return
