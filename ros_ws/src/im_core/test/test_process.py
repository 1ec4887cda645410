"""Child processes take what they are given, are ended in time, and say how they ended."""

import signal
import sys

import pytest

from im_core import clock
from im_core.errors import LinkError
from im_core.process import ChildProcess, last_words

DEAF = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True); signal.pause()"


def python(tmp_path, code, **options):
    return ChildProcess([sys.executable, "-S", "-E", "-c", code], name="it", log=tmp_path / "log", **options)


def test_a_child_reads_text_of_any_length_and_says_how_it_ended(tmp_path):
    child = python(tmp_path, "import sys; print(len(sys.stdin.read())); sys.exit(3)", stdin="x" * 1_000_000)
    assert child.await_end(60.0)
    with pytest.raises(LinkError, match="the process it ended with code 3: 1000000"):
        child.check()
    child.stop()  # what has ended can be stopped


def test_who_does_not_listen_is_killed(tmp_path):
    child = python(tmp_path, DEAF)
    deadline = clock.monotonic() + 60.0
    while not child.last_words() and clock.monotonic() < deadline:
        clock.sleep(0.01)
    child.check()
    child.stop(timeout_s=0.1)
    assert child.poll() == -signal.SIGKILL


def test_a_child_has_the_environment_it_is_given(tmp_path):
    child = python(tmp_path, "import os; print(os.environ['COLOUR'])", environment={"COLOUR": "red"})
    assert child.await_end(60.0)
    assert child.last_words() == "red"


def test_a_module_is_run_with_its_arguments(tmp_path):
    child = ChildProcess.of_module("this.is_none", ["a"], log=tmp_path / "log")
    assert child.await_end(60.0)
    assert "the process this.is_none ended with code 1" in child.obituary()


@pytest.mark.parametrize(("text", "words"), [("a\nb\n\n", "b"), ("", ""), ("only", "only")])
def test_last_words(tmp_path, text, words):
    (tmp_path / "log").write_text(text)
    assert last_words(tmp_path / "log") == words
    assert last_words(tmp_path / "none") == ""


def test_the_words_of_an_earlier_process_are_not_its_own(tmp_path):
    first = python(tmp_path, "raise SystemExit('disk full')")
    assert first.await_end(60.0)
    assert first.obituary() == "the process it ended with code 1: disk full"
    second = python(tmp_path, "raise SystemExit(2)")
    assert second.await_end(60.0)
    assert second.obituary() == "the process it ended with code 2"


def test_who_was_killed_had_no_time_for_last_words(tmp_path):
    child = python(tmp_path, DEAF)
    deadline = clock.monotonic() + 60.0
    while not child.last_words() and clock.monotonic() < deadline:
        clock.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    assert child.await_end(60.0)
    assert child.obituary() == "the process it ended with code -9"
