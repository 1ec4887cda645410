"""End signals reach a handler, but for the signal that ``nohup`` had ignored."""

import signal
import subprocess
import sys

import pytest

from im_core.processes.end_signals import END_SIGNALS

HEEDS = """
import time
from im_core.processes.end_signals import {way}_end_signals

came = []
{way}_end_signals(lambda number, *_: came.append(number))
print("up", flush=True)
while len(came) < {count}:
    time.sleep(0.01)
print(*sorted(map(int, came)))
"""

LOCKED = """
import threading
from im_core.processes.end_signals import heed_end_signals

lock, done = threading.Lock(), threading.Event()

def act(number):
    with lock:
        done.set()

with lock:
    heed_end_signals(act)
    print("up", flush=True)
    input()
assert done.wait(60.0)
print("done")
"""

COPIED = """
import os, signal, time
from im_core.processes.end_signals import heed_end_signals

came = []
heed_end_signals(came.append)
reading, writing = os.pipe()
if not (copy := os.fork()):
    os.write(writing, b".")
    time.sleep(60.0)
    os._exit(0)
os.read(reading, 1)
os.kill(copy, signal.SIGTERM)
print(os.WTERMSIG(os.waitpid(copy, 0)[1]), came)
"""


def begun(program, ignored=()):
    """A program that says that it is up, with some signals ignored from the beginning."""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: [signal.signal(number, signal.SIG_IGN) for number in ignored],
    )
    assert process.stdout.readline() == "up\n"
    return process


@pytest.mark.parametrize("way", ["heed", "handle"])
@pytest.mark.parametrize(
    ("ignored", "heeded"),
    [
        ([], END_SIGNALS),
        ([signal.SIGHUP], (signal.SIGINT, signal.SIGTERM)),  # nohup
        ([signal.SIGINT], END_SIGNALS),  # a shell does so with what it starts in the background
    ],
    ids=["usual", "nohup", "background"],
)
def test_which_signals_are_heeded(way, ignored, heeded):
    process = begun(HEEDS.format(way=way, count=len(heeded)), ignored)
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        process.send_signal(number)
    said, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0
    assert [int(number) for number in said.split()] == sorted(heeded)


def test_a_function_may_take_a_lock_that_the_main_thread_holds():
    """As ``Event.set`` does, during a wait for the event."""
    process = begun(LOCKED)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate("\n", timeout=60.0)
    assert said == "done\n"


def test_a_copy_of_a_process_that_heeds_signals_ends_by_one_and_tells_the_other_nothing():
    said = subprocess.run([sys.executable, "-c", COPIED], capture_output=True, text=True, timeout=60.0).stdout
    assert said == f"{int(signal.SIGTERM)} []\n"
