"""Return of unused memory to the kernel: freed memory, and memory filled with zeros by a library."""

import ctypes
import gc
import mmap

import numpy as np

from im_core.processes.procfs import mappings

#: Mappings that are looked at are at least so large; stacks of threads are smaller [bytes].
_LARGE = 64 << 20
#: What is given back is whole blocks of zeros of this size [bytes].
_BLOCK = 64 << 10
_LIBC = ctypes.CDLL(None, use_errno=True)


def give_back_freed() -> None:
    """Give back the remains of a large piece of work: objects in reference cycles, and free pages.

    The collector of the interpreter looks at old objects late, and ``malloc`` keeps what is freed below what is in
    use, in each of its arenas (as many as 8 for each processor); a thread that works later may get another arena.
    To be called by the thread that has done the work, for it stops the others for some 0.1 s.
    """
    gc.collect()
    _LIBC.malloc_trim(ctypes.c_size_t(0))


def give_back_zeros() -> int:
    """Give back large anonymous blocks with nothing but zeros; the blocks read as zeros ever after.

    To be called while no other thread of the process writes to them.

    Returns:
        How much it was [bytes].
    """
    given = 0
    for begin, end in mappings(_LARGE):
        begin += -begin % _BLOCK
        count = (end - begin) // _BLOCK
        memory = memoryview((ctypes.c_char * (count * _BLOCK)).from_address(begin)).cast("B")
        zero = ~np.frombuffer(memory, dtype=np.uint64).reshape(count, -1).any(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], zero, [0])).astype(np.int8)))
        for first, last in edges.reshape(-1, 2).tolist():
            size = (last - first) * _BLOCK
            if _LIBC.madvise(ctypes.c_void_p(begin + first * _BLOCK), ctypes.c_size_t(size), mmap.MADV_DONTNEED) == 0:
                given += size
    return given
