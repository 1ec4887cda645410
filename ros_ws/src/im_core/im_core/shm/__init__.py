"""Shared memory and semaphores between the processes of one host (the paper's inter-processor blocking).

Every object has a name under ``/dev/shm``; its creator owns it, unlinks it at the end, and may be killed at any moment:
a name left behind by a dead owner is replaced by the next creator and refused to whoever attaches.

- :class:`SharedBlock`: named bytes with an owner.
- :class:`Semaphore`: named counter to wait on.
- :class:`SharedRecord`: named fields with semaphores; the fields may be snapshots and rings.
- :class:`Snapshot`: one structured record, one writer, any number of readers, never torn (seqlock).
- :class:`MessageRing`: JSON messages from one writer to one reader, in order.
"""

from im_core.shm.block import SharedBlock, dead_owner
from im_core.shm.record import SharedRecord
from im_core.shm.ring import MessageRing
from im_core.shm.semaphore import Semaphore
from im_core.shm.snapshot import Snapshot

__all__ = ["MessageRing", "Semaphore", "SharedBlock", "SharedRecord", "Snapshot", "dead_owner"]
