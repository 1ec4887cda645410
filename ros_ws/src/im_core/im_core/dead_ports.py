"""Pass over ports of Fast DDS in shared memory with a killed reader, leave removed ports, and end unfinished ones.

- Upstream: a new process gets the first port without a living reader. The watch of the senders notices a dead reader
  that waited for a message or was busy with one. A reader killed between the two looks alive for ever: senders go on
  to write into the removed memory, and each next process at that port hears nothing of them.
- Mend: lock such ports while a process takes its own; Fast DDS passes over a locked port. The locks are shared: of
  processes that begin at once each passes over them. They are not held for longer: where the last writer removes a
  locked port, each new process would print an error. No port stays locked during the look at all processes: its
  reader may be about to make it anew.
- Second mend: more dead ports than are passed over, a program in bare rclpy, and a port that a busy computer made look
  dead, all leave writers with removed memory. A node looks for such memory of its own and marks the port as broken;
  Fast DDS opens a broken port anew.
- Third mend: a process killed while it makes a port leaves an unfinished file. Each process that opens the port waits
  for ever, holds its locks and the interpreter, and may be of another ROS domain. Nodes and the supervisor of the
  machine mark such a file as boost marks a failure, which ends the waits, and remove it.
- Issue: https://github.com/eProsima/Fast-DDS/issues/5469, open; pull request 4728 there, which marked removed ports as
  broken, too, was closed.
- Seen: Fast DDS 2.14 (Jazzy), ``SharedMemGlobal.hpp``.
- Test: ``test_fast_dds_still_leaves_the_next_process_deaf`` in ``test/test_dead_ports.py`` fails once upstream has
  mended the first fault.
"""

import os
import re
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from im_core import clock
from im_core.ownership import is_own
from im_core.shm_names import SHM, lock, mapped

#: Ports passed over at most, the last made first: a process has two, Fast DDS tries 100 for each, and living processes
#: need some.
MOST_HELD = 96
#: Wall time between two looks of a node for removed ports of its own [s].
RENEWAL_S = 5.0
#: Age at which the maker of an unfinished port counts as killed [s]; a living one takes microseconds.
UNFINISHED_S = 3.0
#: First word of shared memory of boost: not begun, being made; failed.
_UNFINISHED, _FAILED = (0, 1), struct.pack("<I", 3)
#: Memory of the present process of a removed port: begin, end, name, number.
_REMOVED = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) rw-s .*/dev/shm/(fastrtps_port(\d+)) \(deleted\)$", re.MULTILINE)
#: Of ``PortNode``: number, listeners, patience and its third [ms], descriptors, waiting, bits; the bit of a good port.
_NODE, _IN_ORDER = struct.Struct("<7I"), 1
#: The lock file of a port with one reader.
_LOCK_FILE = re.compile(r"(fastrtps_port\d+)_el")


@contextmanager
def passed_over() -> Iterator[list[str]]:
    """Hold the dead ports while a block makes the first node of a context, for which Fast DDS chooses the ports.

    Yields:
        Names of the ports.
    """
    while end_unfinished():
        clock.sleep(0.05)
    made: dict[str, int] = {}
    for path in filter(is_own, SHM.glob("fastrtps_port*_el")):
        if match := _LOCK_FILE.fullmatch(path.name):
            with suppress(OSError):  # of a living process, or removed by the last writer
                os.close(lock(path, shared=True))
                made[match[1]] = (SHM / match[1]).stat().st_mtime_ns
    dead: list[str] = []
    with ExitStack() as held:
        # the look at all processes takes long, and most starts find nothing to look for
        for port in sorted(made.keys() & mapped() if made else (), key=made.__getitem__)[-MOST_HELD:]:
            with suppress(OSError):  # its reader has made it anew meanwhile
                held.callback(os.close, lock(SHM / f"{port}_el", shared=True))
                dead.append(port)
        yield dead


def own_ports() -> set[str]:
    """Return the ports that the present process reads; a process without a context of nodes reads none."""
    found = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            path = descriptor.readlink()
            if path.parent == SHM and (match := _LOCK_FILE.fullmatch(path.name)):
                found.add(match[1])
    return found


def end_unfinished() -> bool:
    """Mark the unfinished ports of killed makers as failed, and remove them.

    Returns:
        Whether there is an unfinished port whose maker may live.
    """
    young = False
    for path in SHM.glob("fastrtps_port*[0-9]"):
        with suppress(OSError), os.fdopen(lock(path), "rb") as file:  # removed, or marked by another process meanwhile
            state = os.fstat(file.fileno())
            if int.from_bytes(file.read(4), "little") not in _UNFINISHED or not state.st_nlink or not is_own(path):
                continue
            if 0.0 <= clock.wall() - state.st_mtime < UNFINISHED_S:
                young = True
                continue
            with path.open("r+b", buffering=0) as memory:
                memory.write(_FAILED if state.st_size > 1 else b"\0")
            path.unlink()
    return young


def renew_ports() -> None:
    """Mark ports as broken to which the process writes, in memory that was removed, while the name has another.

    Unfinished ports are ended, too: a process that waits for one cannot do so.
    """
    end_unfinished()
    removed = _REMOVED.findall(Path("/proc/self/maps").read_text(encoding="utf-8"))
    own = own_ports() if removed else set()
    for begin, end, port, number in removed:
        if port in own or not (SHM / port).exists():
            continue
        with suppress(OSError), Path("/proc/self/mem").open("r+b", buffering=0) as memory:  # unmapped meanwhile
            place = int(begin, 16)
            content = os.pread(memory.fileno(), int(end, 16) - place, place)
            for found in re.finditer(re.escape(struct.pack("<I", int(number))), content):
                at = found.start()
                if at % 4 or at + _NODE.size > len(content):
                    continue
                *_, patience, third, _, _, bits = _NODE.unpack_from(content, at)
                if patience and third == patience // 3 and bits & _IN_ORDER:
                    word = struct.pack("<I", bits & ~_IN_ORDER)
                    os.pwrite(memory.fileno(), word, place + at + _NODE.size - len(word))
