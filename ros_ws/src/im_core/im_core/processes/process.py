"""Child processes: tasks of a deployment, servo, control laws, bridges to robots, physics, cameras."""

import contextlib
import ctypes
import gc
import importlib.util
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import BinaryIO, Self

from im_core import clock
from im_core.errors import LinkError
from im_core.patience import Patience

_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
_KILLED_S = 1.0
_POLL_S = 0.01
_MOST_ORDERS = 1 << 20
#: How a module is run: what is in the folder in which the user happens to be is none of ours.
_PYTHON = (sys.executable, "-u", "-P", "-m")
#: Where in /proc/PID/stat, behind the name, it is told from where to where its arguments are in its memory.
_ARGUMENTS = slice(45, 47)
_LIBC = ctypes.CDLL(None, use_errno=True)


class ChildProcess:
    """Process in a separate session; ends with the starting process.

    Args:
        argv: Program and arguments.
        name: What it is called in messages; the program by default.
        log: File its output is appended to; None: its output goes where this process's goes.
        stdin: What it reads from standard input.
        environment: Its environment; None: that of this process.
        death_signal: What the kernel sends it when the thread that started it ends; None: it lives on.
        inherit: File descriptors of this process that it gets, with the same numbers.
        copied: Whether it begins as a copy of this process, which :func:`may_copy` permits: what is loaded here need
            not be loaded there, and takes its memory once.
    """

    def __init__(
        self,
        argv: Sequence[str],
        *,
        name: str | None = None,
        log: Path | None = None,
        stdin: str = "",
        environment: Mapping[str, str] | None = None,
        death_signal: signal.Signals | None = signal.SIGKILL,
        inherit: Sequence[int] = (),
        copied: bool = False,
    ) -> None:
        self.name = name or Path(argv[0]).name
        self._log, self._log_begin = log, 0
        parent = os.getpid()
        prepared = _prepared.pop(argv[len(_PYTHON)], None) if _is_module(argv) else None
        with ExitStack() as files:
            output: BinaryIO | None = None
            if log is not None:
                log.parent.mkdir(parents=True, exist_ok=True)
                output = files.enter_context(log.open("ab"))
                self._log_begin = output.tell()
            # a file in memory: a pipe of limited size would make this process wait for its child to read
            given = files.enter_context(open(os.memfd_create("stdin"), "w+b"))
            given.write(stdin.encode())
            given.seek(0)
            self._process: subprocess.Popen[bytes] | _Copy
            standard = [given.fileno(), *([output.fileno()] * 2 if output is not None else [])]
            if prepared is not None and prepared.run(argv, environment or os.environ, standard):
                self._process = prepared
            elif copied:
                self._process = _Copy()
                if self._process.pid == 0:
                    os.setsid()
                    _end_with(parent, death_signal)
                    _keep_open(standard, inherit)
                    ctypes.pythonapi.Py_Exit(_run(argv, environment))
            else:
                self._process = subprocess.Popen(
                    argv,
                    stdin=given,
                    stdout=output,
                    stderr=None if output is None else subprocess.STDOUT,
                    env=environment,
                    preexec_fn=lambda: _end_with(parent, death_signal),
                    start_new_session=True,
                    pass_fds=inherit,
                )
        self.pid = self._process.pid

    @classmethod
    def of_module(
        cls,
        module: str,
        arguments: Sequence[str] = (),
        *,
        log: Path | None = None,
        stdin: str = "",
        inherit: Sequence[int] = (),
    ) -> Self:
        """Run a module with ``python -m``, or by the prepared copy; arguments as of the class.

        Its name is that of the module.
        """
        return cls([*_words(module), *arguments], name=module, log=log, stdin=stdin, inherit=inherit)

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raise if the child is gone.

        Raises:
            LinkError: It ended; the message is its :meth:`obituary`.
        """
        if self.poll() is not None:
            raise LinkError(self.obituary(), exit_code=self.poll())

    def obituary(self) -> str:
        """Describe the end of the process, with the last line written."""
        words = self.last_words()
        return f"the process {self.name} ended with code {self.poll()}{': ' + words if words else ''}"

    def last_words(self) -> str:
        """Return the last line written to the log by the process; empty if killed by SIGKILL without time."""
        if self._log is None or self.poll() == -signal.SIGKILL:
            return ""
        return last_words(self._log, self._log_begin)

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal; no effect on an ended process."""
        self._process.send_signal(number)

    def await_end(self, timeout_s: float) -> bool:
        """Wait for the end, at most ``timeout_s`` [s], without looking at anything else; return whether ended."""
        if self.poll() is not None:
            return True
        descriptor = os.pidfd_open(self.pid)
        try:
            select.select([descriptor], [], [], max(0.0, timeout_s))
        finally:
            os.close(descriptor)
        return self.poll() is not None

    def stop(self, timeout_s: float = 2.0) -> None:
        """End the process with SIGTERM, after ``timeout_s`` [s] with SIGKILL, counted as by :class:`.Patience`."""
        patience = Patience([self.pid])
        self.send_signal(signal.SIGTERM)
        if not await_ends([self], patience, timeout_s):
            self.send_signal(signal.SIGKILL)
            self.await_end(_KILLED_S)


class _Copy:
    """Copy of the process, with the parts of :class:`subprocess.Popen` in use here.

    Attributes:
        pid: Process id; 0 in the copy itself.
    """

    def __init__(self) -> None:
        gc.freeze()  # a collector that looked at what is common would give each process its own
        self.pid = os.fork()
        self._code: int | None = None
        if self.pid == 0:
            while _prepared:  # those are children of the other
                _prepared.popitem()[1].forget()

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal; no effect on an ended process."""
        if self.poll() is None:
            os.kill(self.pid, number)


class _Prepared(_Copy):
    """Copy of the process, with a module loaded, waiting for the order to run; the copy dies with the thread."""

    def __init__(self, module: str) -> None:
        self._orders, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        parent = os.getpid()
        super().__init__()
        if self.pid == 0:
            self._orders.detach()
            os.setsid()
            _end_with(parent, signal.SIGKILL)
            _keep_open([os.open(os.devnull, os.O_RDONLY)], [its.fileno()])
            ctypes.pythonapi.Py_Exit(_run_when_told(module, its))
        its.close()

    def run(self, argv: Sequence[str], environment: Mapping[str, str], standard: Sequence[int]) -> bool:
        """Run the module in the copy; return whether the copy exists; ``standard``: first descriptors, in order."""
        orders = json.dumps({"argv": list(argv), "environment": dict(environment)}).encode()
        try:
            socket.send_fds(self._orders, [orders], standard)
        except OSError:
            self.end()
            return False
        self._orders.close()
        return True

    def forget(self) -> None:
        """Leave the copy to the parent process, and keep the file descriptor open."""
        self._orders.detach()

    def end(self) -> None:
        """End the copy."""
        self._orders.close()
        self.send_signal(signal.SIGKILL)
        if self._code is None:
            os.waitpid(self.pid, 0)


#: The copies that wait, by the name of their module.
_prepared: dict[str, _Prepared] = {}


def prepare(module: str) -> None:
    """Let a copy of the process load a module now, for a child to run later (:meth:`ChildProcess.of_module`).

    What is loaded here need not be loaded there, takes its memory once, and the rest is loaded beside what this process
    loads. Nothing is done where this process may not be copied, or has loaded ROS, which such children must not have.
    """
    if "rclpy" not in sys.modules and _is_single():
        _prepared[module] = _Prepared(module)


def dismiss_prepared() -> None:
    """End the copies never told to run."""
    while _prepared:
        _prepared.popitem()[1].end()


def may_copy(program: str) -> bool:
    """Return whether a program may begin as a copy: same Python as the present process, and a single thread.

    Other threads would not be in the copy, but what they have locked would be locked there for ever.
    """
    with open(program, "rb") as file:
        first = file.readline(4096)
    return first.rstrip() == f"#!{sys.executable}".encode() and _is_single()


def _is_single() -> bool:
    return len(os.listdir("/proc/self/task")) == 1


def _words(module: str) -> tuple[str, ...]:
    return *_PYTHON, module


def _is_module(argv: Sequence[str]) -> bool:
    return len(argv) > len(_PYTHON) and tuple(argv[: len(_PYTHON)]) == _PYTHON


def _end_with(parent: int, death_signal: signal.Signals | None) -> None:
    """Let the kernel signal a new process when the starting thread ends."""
    if death_signal is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, death_signal)
        if os.getppid() != parent:  # it has ended already
            os.kill(os.getpid(), death_signal)


def _keep_open(standard: Sequence[int], others: Collection[int]) -> None:
    """Make file descriptors the standard ones, in order, and close all neither standard nor in ``others``."""
    for number, descriptor in enumerate(standard):
        os.dup2(descriptor, number)
    for descriptor in map(int, os.listdir("/proc/self/fd")):
        if descriptor > 2 and descriptor not in others:
            with contextlib.suppress(OSError):  # the one that listed them
                os.close(descriptor)


def _run(argv: Sequence[str], environment: Mapping[str, str] | None) -> int:
    """Run a Python script or module as if started with the process; return the exit code."""
    if environment is not None:
        os.environ.clear()
        os.environ.update(environment)
    _tell(argv)
    try:
        if _is_module(argv):
            module, *_ = sys.argv = list(argv[len(_PYTHON) :])
            runpy.run_module(module, run_name="__main__", alter_sys=True)
        else:
            sys.argv = list(argv)
            runpy.run_path(argv[0], run_name="__main__")
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        print(end.code, file=sys.stderr)
        return 1
    except BaseException:  # told, as the interpreter would
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


def _run_when_told(module: str, orders: socket.socket) -> int:
    """Load a module, run the module on order, and return the exit code."""
    _tell(_words(module))
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # neither is replaced
    with contextlib.suppress(Exception):  # whatever it raises, it does so again when it is run, and tells it then
        found = importlib.util.find_spec(module)
        main = module if found is None or found.submodule_search_locations is None else f"{module}.__main__"
        import_module(main)
        del sys.modules[main]  # it will be __main__; what it has loaded stays
    told, standard, *_ = socket.recv_fds(orders, _MOST_ORDERS, 3)
    if not told:
        return 0
    wanted = json.loads(told)
    orders.detach()
    _keep_open(standard, [])
    return _run(wanted["argv"], wanted["environment"])


def _tell(argv: Sequence[str]) -> None:
    """Show the given arguments and program in the kernel's data of the process, as far as space permits."""
    name = argv[len(_PYTHON)].rpartition(".")[2] if _is_module(argv) else Path(argv[0]).name
    _LIBC.prctl(_PR_SET_NAME, name.encode())
    with open("/proc/self/stat", encoding="ascii", errors="replace") as file:
        begin, end = map(int, file.read().rpartition(")")[2].split()[_ARGUMENTS])
    text = "\0".join(argv).encode()[: max(0, end - begin - 1)]
    ctypes.memmove(begin, text.ljust(end - begin, b"\0"), end - begin)


def await_ends(children: Sequence[ChildProcess], patience: Patience, until_s: float) -> bool:
    """Wait until all children have ended, within the limit counted by patience [s]; return whether all ended."""
    while any(child.poll() is None for child in children):
        if patience.look() >= until_s:
            return False
        clock.sleep(_POLL_S)
    return True


def last_words(log: Path, begin: int = 0) -> str:
    """Return the last non-empty line of a log, or an empty string; arguments as of :func:`end_of_log`."""
    lines = [line.strip() for line in end_of_log(log, begin, 4096).splitlines() if line.strip()]
    return lines[-1] if lines else ""


def end_of_log(log: Path, begin: int, most_bytes: int) -> str:
    """Return the end of a log, from the byte ``begin`` on; empty if not readable.

    Of a log that is shorter than ``begin`` all counts: it was rotated since.
    """
    try:
        with log.open("rb") as file:
            end = file.seek(0, os.SEEK_END)
            file.seek(max(begin if begin <= end else 0, end - most_bytes))
            return file.read().decode(errors="replace")
    except OSError:
        return ""
