import os
import subprocess
import sys
import threading
import time

import pytest

from bench.usage import cpu_s, ended_children_s, memory_mib

#: A process of its own: the one that runs the tests may have any size, and memory to use again.
SIZES = """
import mmap, os, sys
def told(): print(memory_mib([os.getpid()]), own_memory_mib([os.getpid()]))
from bench.usage import memory_mib, own_memory_mib
told()
with open(sys.argv[1], "rb") as file:
    mapped = mmap.mmap(file.fileno(), 0, mmap.MAP_PRIVATE, mmap.PROT_READ)
sum(mapped[::4096])
told()
written = bytearray(b"1") * (64 * 2**20)
told()
"""


def test_own_memory_is_what_was_written_and_not_what_was_read_of_a_file(tmp_path):
    (tmp_path / "library").write_bytes(bytes(32 * 2**20))
    told = subprocess.check_output([sys.executable, "-c", SIZES, tmp_path / "library"], text=True, timeout=60.0)
    (whole, own), (whole_mapped, own_mapped), (_, own_written) = (
        map(float, line.split()) for line in told.splitlines()
    )
    assert 1.0 < whole < 1000.0
    assert whole_mapped - whole > 30.0
    assert own_mapped - own < 2.0
    assert own_written - own_mapped > 60.0


def test_a_process_that_is_not_there_has_no_memory():
    assert memory_mib([2**30]) == pytest.approx(0.0)


def test_cpu_time_of_a_process_has_that_of_threads_that_ended():
    """A node answers many a request in a thread of its own."""
    used = []

    def work():
        while time.thread_time() < 0.1:
            pass
        used.append(time.thread_time())

    before = cpu_s(os.getpid())
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert cpu_s(os.getpid()) - before >= used[0]


def test_a_process_that_has_ended_is_told():
    with pytest.raises(ProcessLookupError, match="no process"):
        cpu_s(2**22 + 1)


def test_cpu_time_of_children_that_ended_is_that_of_those_that_were_waited_for():
    code = "import time\nwhile time.process_time() < 0.3: pass"
    before = ended_children_s(os.getpid())
    child = subprocess.Popen([sys.executable, "-c", code])
    child.wait()
    assert 0.25 < ended_children_s(os.getpid()) - before < 5.0
    assert ended_children_s(child.pid) == pytest.approx(0.0)
