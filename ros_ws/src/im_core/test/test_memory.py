"""Memory is given back only where nothing is in it, and reads as before."""

import subprocess
import sys

PROGRAM = """
import mmap, re
from im_core.processes.memory import give_back_zeros
def resident():
    return int(re.search(r"VmRSS:\\s+(\\d+)", open("/proc/self/status").read())[1]) << 10
LARGE, WRITTEN = 96 << 20, 40 << 20
memory = mmap.mmap(-1, LARGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
for at in range(0, LARGE, 4096):
    memory[at] = 0
memory[WRITTEN : WRITTEN + 7] = b"content"
memory[LARGE - 1] = 255
before = resident()
given = give_back_zeros()
assert before - resident() > LARGE - (8 << 20), (before, resident())
assert given >= LARGE - (1 << 20), given
content = bytearray(LARGE)
content[WRITTEN : WRITTEN + 7], content[LARGE - 1] = b"content", 255
assert memory[:] == content
memory[5000] = 1
assert memory[4999:5002] == bytes((0, 1, 0))
"""


def test_blocks_of_zeros_are_given_back_and_everything_reads_as_before():
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)
