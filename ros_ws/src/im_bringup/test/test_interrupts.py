"""The first signal that asks to end interrupts a command, once, and not while a process is being started."""

import subprocess
import sys

import pytest

BEGIN = """
import os, signal
from im_bringup.machine.interrupts import ignore_interrupts, interrupt_once, interrupts_held

def send(*names):
    for name in names:
        os.kill(os.getpid(), getattr(signal, name))

"""


def said(code):
    done = subprocess.run([sys.executable, "-c", BEGIN + code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@pytest.mark.parametrize("first", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_command_is_interrupted_once(first):
    code = f"""
interrupt_once()
try:
    send("{first}")
    print("goes-on")
except KeyboardInterrupt:
    send("SIGINT", "SIGTERM", "SIGHUP")
    print("interrupted")
"""
    assert said(code) == ["interrupted"]


def test_a_command_that_goes_on_after_an_interruption_may_be_interrupted_once_more():
    code = """
for _ in range(2):
    interrupt_once()
    try:
        send("SIGINT")
        print("goes-on")
    except KeyboardInterrupt:
        send("SIGINT", "SIGTERM")
        print("interrupted")
"""
    assert said(code) == ["interrupted", "interrupted"]


def test_signals_that_come_together_interrupt_once():
    code = """
interrupt_once()
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
send("SIGINT", "SIGTERM", "SIGHUP")
try:
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    print("goes-on")
except KeyboardInterrupt:
    print("interrupted")
"""
    assert said(code) == ["interrupted"]


@pytest.mark.parametrize("names", ["'SIGTERM'", "'SIGHUP', 'SIGINT'"])
def test_what_begins_while_interrupts_are_held_is_there_before_one_comes(names):
    code = f"""
interrupt_once()
try:
    with interrupts_held():
        send({names})
        print("begun")
    print("goes-on")
except KeyboardInterrupt:
    print("interrupted")
"""
    assert said(code) == ["begun", "interrupted"]


def test_interrupts_that_are_no_longer_held_are_as_before():
    code = """
interrupt_once()
with interrupts_held():
    print("begun")
try:
    send("SIGHUP")
except KeyboardInterrupt:
    print("interrupted")
"""
    assert said(code) == ["begun", "interrupted"]


def test_a_command_that_ignores_interrupts_comes_to_its_end():
    assert said("ignore_interrupts(); send('SIGINT', 'SIGTERM', 'SIGHUP'); print('done')") == ["done"]


def test_a_signal_while_the_interpreter_ends_is_ignored_though_a_thread_of_a_library_does_not_block_it():
    """As numpy has: it takes the signal, and the handlers of Python are gone by then."""
    script = """
import os, signal, sys, threading
from im_bringup.machine.interrupts import ignore_interrupts

class Last:
    def __del__(self, kill=os.kill, pid=os.getpid(), signals=(signal.SIGTERM, signal.SIGINT, signal.SIGHUP)):
        for number in signals:
            kill(pid, number)
        os.write(1, b"last")

signal.signal(signal.SIGTERM, lambda *_: None)
threading.Thread(target=threading.Event().wait, daemon=True).start()
last = Last()
ignore_interrupts()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "last", "")
