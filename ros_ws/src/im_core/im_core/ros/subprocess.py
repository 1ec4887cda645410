"""Child processes without rclpy: servo, physics, cameras."""

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from im_core import clock
from im_core.errors import LinkError

PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


def _die_with_parent() -> None:
    _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class ChildProcess:
    """A Python module run as a process of its own, which dies with this one.

    Args:
        module: Module to run with ``python -m``.
        arguments: Its arguments.
        log: File its output is appended to.
    """

    def __init__(self, module: str, arguments: Sequence[str], log: Path) -> None:
        self.module = module
        self._log = log
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                preexec_fn=_die_with_parent,
                start_new_session=True,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raise if the child is gone.

        Raises:
            LinkError: It ended; the message carries the last line it wrote.
        """
        code = self.poll()
        if code is not None:
            raise LinkError(f"the process {self.module} ended with code {code}: {self.last_words()}", exit_code=code)

    def last_words(self) -> str:
        """The last line of its log."""
        try:
            lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            return ""
        return lines[-1] if lines else ""

    def terminate(self, timeout_s: float = 2.0) -> None:
        """End it with SIGTERM, after ``timeout_s`` with SIGKILL."""
        if self.poll() is None:
            self._process.terminate()
            deadline = clock.monotonic() + timeout_s
            while self.poll() is None and clock.monotonic() < deadline:
                clock.sleep(0.01)
            if self.poll() is None:
                self._process.kill()
        self._process.wait()
