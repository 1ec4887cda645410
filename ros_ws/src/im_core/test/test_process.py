"""Child processes take what they are given, are ended in time, and say how they ended."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from im_core import clock
from im_core.errors import LinkError
from im_core.processes.process import ChildProcess, last_words, may_copy

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


COPIES = """\
import fractions, sys
from pathlib import Path
from im_core.processes.process import ChildProcess, may_copy
script, log = sys.argv[1:]
assert may_copy(script)
child = ChildProcess([script, "a"], log=Path(log), stdin="given", environment={"COLOUR": "red"}, copied=True)
while not child.await_end(60.0):
    pass
child.stop()
print(child.obituary())
"""
SAYS = """\
import os, sys
print(sys.argv[1:], os.environ["COLOUR"], sys.stdin.read(), "fractions" in sys.modules, end=" ")
print(sorted(os.listdir("/proc/self/fd")))
print(open("/proc/self/comm").read().strip())
"""


@pytest.mark.parametrize(
    ("end", "told"),
    [
        ("sys.exit(3)", "code 3: says"),
        ("sys.exit('disk full')", "code 1: disk full"),
        ("1 / 0", "code 1: ZeroDivisionError: division by zero"),
        ("import atexit; atexit.register(print, 'closed')", "code 0: closed"),
        ("os.kill(os.getpid(), 9)", "code -9"),
    ],
)
def test_a_copy_is_the_program_that_it_runs_and_finds_loaded_what_was_loaded(tmp_path, end, told):
    script, log = program(tmp_path, sys.executable, SAYS + end), tmp_path / "log"
    done = subprocess.run([sys.executable, "-c", COPIES, script, log], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"the process says ended with {told}"
    assert log.read_text().startswith("['a'] red given True ['0', '1', '2', '3']\nsays\n")  # 3: what lists them


def test_only_a_program_of_this_python_begins_as_a_copy_and_only_of_one_thread(tmp_path):
    ours, other = (program(tmp_path, python, "") for python in (sys.executable, "/usr/bin/python3"))
    code = "import sys, threading; from im_core.processes.process import may_copy; print(*map(may_copy, sys.argv[1:]))"
    told = [sys.executable, "-c", code, ours, other, sys.executable]
    assert subprocess.run(told, capture_output=True, text=True, check=True).stdout.split() == ["True", "False", "False"]
    with threaded():
        assert not may_copy(ours)


def program(tmp_path, python, code):
    """A program of its own folder, by name ``says``."""
    path = tmp_path / python.replace("/", "_") / "says"
    path.parent.mkdir()
    path.write_text(f"#!{python}\n{code}\n")
    path.chmod(0o755)
    return str(path)


@contextlib.contextmanager
def threaded():
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    yield
    end.set()
    thread.join()


PREPARES = """\
import fractions, sys
from pathlib import Path
from im_core.processes.process import ChildProcess, dismiss_prepared, prepare
folder, told = Path(sys.argv[1]), sys.argv[2]
if told == "ros":
    sys.modules["rclpy"] = sys
prepare("says")
if told == "dismissed":
    dismiss_prepared()
child = ChildProcess.of_module("says", ["a"], log=folder / "log", stdin="given")
while not child.await_end(60.0):
    pass
child.stop()
print(child.obituary())
"""
MODULE = """\
import os, sys
if __name__ == "__main__":
    print(sys.argv[1:], os.environ["COLOUR"], sys.stdin.read(), "fractions" in sys.modules)
    print(sorted(os.listdir("/proc/self/fd")))
    print(open("/proc/self/comm").read().strip())
    print(open("/proc/self/cmdline").read().rstrip("\\0").split("\\0")[1:])
    sys.exit("disk full")
"""


@pytest.mark.parametrize(
    ("told", "loaded", "name"), [("taken", True, "says"), ("dismissed", False, "python"), ("ros", False, "python")]
)
def test_a_module_is_run_by_the_copy_that_was_prepared_for_it_if_there_is_one(tmp_path, told, loaded, name):
    modules, here = tmp_path / "modules", tmp_path / "here"
    for folder in (modules, here):
        folder.mkdir()
    (modules / "says.py").write_text(MODULE)
    (here / "runpy.py").write_text("raise SystemExit('what is where the user happens to be was run')")
    run = [sys.executable, "-P", "-c", PREPARES, tmp_path, told]
    path = os.pathsep.join(filter(None, (str(modules), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "COLOUR": "red", "PYTHONPATH": path}
    done = subprocess.run(run, capture_output=True, text=True, check=True, cwd=here, env=environment)
    assert done.stdout.strip() == "the process says ended with code 1: disk full"
    words, files, comm, arguments, _ = (tmp_path / "log").read_text().splitlines()
    assert words == f"['a'] red given {loaded}"
    assert files == "['0', '1', '2', '3']"  # 3: what lists them
    assert comm.startswith(name)
    assert arguments == "['-u', '-P', '-m', 'says', 'a']"


def test_what_waits_to_run_a_module_ends_with_who_prepared_it(tmp_path):
    code = "from im_core.processes import process; process.prepare('json'); print(process._prepared['json'].pid)"
    pid = int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
    deadline = clock.monotonic() + 60.0
    while Path(f"/proc/{pid}").exists() and clock.monotonic() < deadline:
        clock.sleep(0.01)
    assert not Path(f"/proc/{pid}").exists()
