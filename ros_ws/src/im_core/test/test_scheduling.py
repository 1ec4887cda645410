"""What a process asks of the scheduler, seen from processes that may and may not have SCHED_FIFO."""

import json
import os
import shutil
import subprocess
import sys

import pytest

PROGRAM = """
import json, os, sys
if not {fifo}:
    def refuse(*_):
        raise PermissionError
    os.sched_setscheduler = refuse
else:
    os.sched_setscheduler = lambda *_: None
from im_core.processes import scheduling
cores = sorted(os.sched_getaffinity(0))
reserved = scheduling.reserve()
os.environ.update(reserved)
again = scheduling.reserve()
scheduling.keep_off()
others = sorted(os.sched_getaffinity(0))
fifo = scheduling.prefer(50, paced={paced})
print(json.dumps([cores, reserved, again, others, fifo, sorted(os.sched_getaffinity(0))]))
"""


def seen(fifo, paced, *before):
    argv = [*before, sys.executable, "-c", PROGRAM.format(fifo=fifo, paced=paced)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return json.loads(subprocess.run(argv, env=environment, capture_output=True, check=True).stdout)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core")
def test_without_fifo_a_paced_process_has_a_core_to_itself():
    cores, reserved, again, others, fifo, own = seen(fifo=False, paced=True)
    assert reserved == {"IM_SERVO_CORE": str(cores[-1])}
    assert again == {}, "whoever starts a machine decides for all of it"
    assert others == cores[:-1]
    assert not fifo
    assert own == [cores[-1]]


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core")
@pytest.mark.parametrize("permitted", [True, False])
def test_as_fast_as_it_goes_nobody_is_moved(permitted):
    """Servo and physics would wait for each other on one core, and starve all others on two with SCHED_FIFO."""
    _, _, _, others, fifo, own = seen(permitted, paced=False)
    assert not fifo
    assert own == others


def test_with_fifo_no_core_is_reserved():
    cores, reserved, _, others, fifo, own = seen(fifo=True, paced=True)
    assert (reserved, fifo) == ({}, True)
    assert cores == others == own


@pytest.mark.skipif(shutil.which("taskset") is None, reason="no taskset")
def test_a_single_core_is_shared():
    one = str(min(os.sched_getaffinity(0)))
    cores, reserved, _, others, _, own = seen(False, True, "taskset", "-c", one)
    assert reserved == {}
    assert cores == others == own


def test_memory_that_is_locked_is_what_was_touched_and_not_all_that_libraries_reserve():
    """A copy of OpenBLAS reserves 32 MiB, and its code is as large again."""
    program = (
        "import mmap, re\n"
        "from im_core.processes import scheduling\n"
        "def kib(key): return int(re.search(key + r':\\s+(\\d+)', open('/proc/self/status').read())[1])\n"
        "reserved = mmap.mmap(-1, 256 << 20, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)\n"
        "before = kib('VmRSS')\n"
        "scheduling.prefer(1, paced=False)\n"
        "after = mmap.mmap(-1, 256 << 20, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)\n"
        "assert kib('VmRSS') - before < 64 << 10\n"
        "locked = kib('VmLck')\n"
        "assert locked == 0 or locked > 512 << 10, locked  # 0 where it is not permitted\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
