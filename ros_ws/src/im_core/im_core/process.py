"""Child processes: tasks of a deployment, servo, control laws, bridges to robots, physics, cameras."""

import contextlib
import ctypes
import gc
import os
import runpy
import select
import signal
import subprocess
import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Self

from im_core import clock
from im_core.errors import LinkError
from im_core.silence import Patience

_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
_KILLED_S = 1.0
_POLL_S = 0.01
_LIBC = ctypes.CDLL(None, use_errno=True)


class ChildProcess:
    """A process in a session of its own, which ends with whoever started it.

    Args:
        argv: Program and arguments.
        name: What it is called in messages; the program by default.
        log: File its output is appended to; None: its output goes where this process's goes.
        stdin: What it reads from standard input.
        environment: Its environment; None: that of this process.
        death_signal: What the kernel sends it when the thread that started it ends; None: it lives on.
        inherit: File descriptors of this process that it gets, with the same numbers.
        copied: Whether it begins as a copy of this process, which :func:`may_copy` permits: what is loaded here need
            not be loaded there, and takes its memory once. The kernel goes on telling how this process was started.

    Attributes:
        name: As given.
        pid: Process id.
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

        def end_with_parent() -> None:
            if death_signal is not None:
                _LIBC.prctl(_PR_SET_PDEATHSIG, death_signal)
                if os.getppid() != parent:  # it has ended already
                    os.kill(os.getpid(), death_signal)

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
            if copied:
                self._process = _Copy()
                if self._process.pid == 0:
                    os.setsid()
                    end_with_parent()
                    _keep_open([given.fileno(), *([output.fileno()] * 2 if output is not None else [])], inherit)
                    ctypes.pythonapi.Py_Exit(_run_script(argv, environment))
            else:
                self._process = subprocess.Popen(
                    argv,
                    stdin=given,
                    stdout=output,
                    stderr=None if output is None else subprocess.STDOUT,
                    env=environment,
                    preexec_fn=end_with_parent,
                    start_new_session=True,
                    pass_fds=inherit,
                )
        self.pid = self._process.pid

    @classmethod
    def of_module(cls, module: str, arguments: Sequence[str] = (), *, log: Path | None = None, stdin: str = "") -> Self:
        """Run a module with ``python -m``; arguments as of the class. Its name is that of the module."""
        return cls([sys.executable, "-u", "-m", module, *arguments], name=module, log=log, stdin=stdin)

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raise if the child is gone.

        Raises:
            LinkError: It ended; the message is its :meth:`obituary`.
        """
        if self.poll() is not None:
            raise LinkError(self.obituary(), exit_code=self.poll())

    def obituary(self) -> str:
        """How it ended, and the last line it wrote."""
        words = self.last_words()
        return f"the process {self.name} ended with code {self.poll()}{': ' + words if words else ''}"

    def last_words(self) -> str:
        """The last line it wrote into its log, not those before it did; empty if SIGKILL left it no time for any."""
        if self._log is None or self.poll() == -signal.SIGKILL:
            return ""
        return last_words(self._log, self._log_begin)

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal; nothing happens if it has ended."""
        self._process.send_signal(number)

    def await_end(self, timeout_s: float) -> bool:
        """Wait until it has ended, at most ``timeout_s`` [s]; whether it has. Nothing is looked at meanwhile."""
        if self.poll() is not None:
            return True
        descriptor = os.pidfd_open(self.pid)
        try:
            select.select([descriptor], [], [], max(0.0, timeout_s))
        finally:
            os.close(descriptor)
        return self.poll() is not None

    def stop(self, timeout_s: float = 2.0) -> None:
        """End it with SIGTERM, after ``timeout_s`` [s] with SIGKILL, counted as :class:`.Patience` does."""
        patience = Patience([self.pid])
        self.send_signal(signal.SIGTERM)
        if not await_ends([self], patience, timeout_s):
            self.send_signal(signal.SIGKILL)
            self.await_end(_KILLED_S)


class _Copy:
    """A copy of this process, with that of :class:`subprocess.Popen` that is used here.

    Attributes:
        pid: Process id; 0 in the copy itself.
    """

    def __init__(self) -> None:
        gc.freeze()  # a collector that looked at what is common would give each process its own
        self.pid = os.fork()
        self._code: int | None = None

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal; nothing happens if it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)


def may_copy(program: str) -> bool:
    """Whether a program may begin as a copy of this process: of Python, of this very one, while there is one thread.

    Other threads would not be in the copy, but what they have locked would be locked there for ever.
    """
    with open(program, "rb") as file:
        first = file.readline(4096)
    return first.rstrip() == f"#!{sys.executable}".encode() and len(os.listdir("/proc/self/task")) == 1


def _keep_open(standard: Sequence[int], others: Collection[int]) -> None:
    """Make file descriptors the standard ones, in their order, and close all that are neither standard nor others."""
    for number, descriptor in enumerate(standard):
        os.dup2(descriptor, number)
    for descriptor in map(int, os.listdir("/proc/self/fd")):
        if descriptor > 2 and descriptor not in others:
            with contextlib.suppress(OSError):  # the one that listed them
                os.close(descriptor)


def _run_script(argv: Sequence[str], environment: Mapping[str, str] | None) -> int:
    """Run a Python script as if this process had been started with it; its exit code."""
    if environment is not None:
        os.environ.clear()
        os.environ.update(environment)
    sys.argv = list(argv)
    _LIBC.prctl(_PR_SET_NAME, Path(argv[0]).name.encode())
    try:
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


def await_ends(children: Sequence[ChildProcess], patience: Patience, until_s: float) -> bool:
    """Wait until all have ended, at most until patience has counted so much [s]; whether they have."""
    while any(child.poll() is None for child in children):
        if patience.look() >= until_s:
            return False
        clock.sleep(_POLL_S)
    return True


def last_words(log: Path, begin: int = 0, most_bytes: int = 4096) -> str:
    """The last line of a log that is not empty, of those from its byte ``begin`` on, or an empty string.

    Of a log that is shorter than ``begin`` all counts: it was rotated since.
    """
    try:
        with log.open("rb") as file:
            end = file.seek(0, os.SEEK_END)
            file.seek(max(begin if begin <= end else 0, end - most_bytes))
            text = file.read().decode(errors="replace")
    except OSError:
        return ""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""
