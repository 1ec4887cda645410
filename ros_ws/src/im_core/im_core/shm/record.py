"""Record of named fields in shared memory, with semaphores."""

from contextlib import ExitStack, closing
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from im_core.errors import LinkError
from im_core.shm.block import SharedBlock
from im_core.shm.semaphore import Semaphore


class SharedRecord:
    """Fields shared by two processes, and the semaphores to wake each other.

    A subclass names its semaphores. A field may be the memory of a :class:`~im_core.shm.ring.MessageRing` or of a
    :class:`~im_core.shm.snapshot.Snapshot`; a plain field is not protected against a read during a write.

    Attributes:
        SEMAPHORES: Names of the semaphores.
        name: Name given by the creator.
        view: The fields by name; scalars have shape ().
    """

    SEMAPHORES: ClassVar[tuple[str, ...]] = ()

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void], semaphores: list[Semaphore]) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.name = block.name
        record = block.array(dtype, 1).reshape(())
        self.view: dict[str, NDArray[Any]] = {name: record[name] for name in dtype.names or ()}
        self._block = block
        self._parts: tuple[Semaphore | SharedBlock, ...] = (*semaphores, block)

    @classmethod
    def create(cls, name: str, dtype: np.dtype[np.void]) -> Self:
        """Create memory, all zeros, and semaphores; remains of a dead owner are replaced.

        Args:
            name: Name of the memory; ``<name>_<semaphore>`` of a semaphore.
            dtype: The fields, aligned.

        Raises:
            LinkError: Another living process, or another user, owns the name, or there is no room; nothing is left.
        """
        with ExitStack() as made:
            block = made.enter_context(SharedBlock.create(name, dtype.itemsize))
            semaphores = [made.enter_context(closing(Semaphore.create(f"{name}_{part}"))) for part in cls.SEMAPHORES]
            record = cls(block, dtype, semaphores)
            block.publish()
            made.pop_all()
        return record

    @classmethod
    def attach(cls, name: str, dtype: np.dtype[np.void], timeout_s: float) -> Self:
        """Attach to a record with a living owner.

        Raises:
            LinkError: It did not appear within ``timeout_s`` [s], is another user's, or has another size.
        """
        with ExitStack() as attached:
            block = attached.enter_context(closing(SharedBlock.attach(name, timeout_s)))
            if block.size != dtype.itemsize:
                raise LinkError(f"shared memory '{name}' has {block.size} bytes, not {dtype.itemsize}", name=name)
            parts = [f"{name}_{part}" for part in cls.SEMAPHORES]
            semaphores = [attached.enter_context(closing(Semaphore.attach(part, timeout_s))) for part in parts]
            attached.pop_all()
        return cls(block, dtype, semaphores)

    def owner_alive(self) -> bool:
        """Return whether the process of the record's creator still runs."""
        return self._block.owner_alive()

    def unlink(self) -> None:
        """Remove the names, as the creator; both sides keep memory and semaphores."""
        for part in self._parts:
            part.unlink()

    def close(self) -> None:
        """Release everything; the creator removes the names."""
        self.view = {}
        for part in self._parts:
            part.close()
