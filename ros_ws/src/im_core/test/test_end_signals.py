"""Signals that ask to end reach a handler, but for the one that ``nohup`` had ignored."""

import signal
import subprocess
import sys

import pytest

from im_core.processes.end_signals import END_SIGNALS

HEEDS = """
import signal
import time
from im_core.processes.end_signals import heed_end_signals

came = []
heed_end_signals(lambda number, _: came.append(number))
print("up", flush=True)
while signal.SIGTERM not in came:
    time.sleep(0.01)
print(*sorted(came))
"""


def heard(ignored, sent):
    """Numbers of the signals that a program heeds which begins with some ignored; SIGTERM ends it."""
    process = subprocess.Popen(
        [sys.executable, "-c", HEEDS],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: [signal.signal(number, signal.SIG_IGN) for number in ignored],
    )
    assert process.stdout.readline() == "up\n"
    for number in sent:
        process.send_signal(number)
    said, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0
    return [int(number) for number in said.split()]


@pytest.mark.parametrize(
    ("ignored", "heeded"),
    [
        ([], END_SIGNALS),
        ([signal.SIGHUP], (signal.SIGINT, signal.SIGTERM)),  # nohup
        ([signal.SIGINT], END_SIGNALS),  # a shell does so with what it starts in the background
    ],
    ids=["usual", "nohup", "background"],
)
def test_which_signals_are_heeded(ignored, heeded):
    assert heard(ignored, [signal.SIGHUP, signal.SIGINT, signal.SIGTERM]) == sorted(heeded)
