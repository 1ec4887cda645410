"""Processes that measure on request: ours, those of peers with an interpreter of their own, and ROS nodes."""

import contextlib
import json
import os
import re
import select
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence

from im_core.clock import monotonic
from im_core.errors import LinkError

_EXCEPTION = re.compile(r"[\w.]+Error\b")
_PATIENCE_S = 120.0
_END_S = 10.0


class Worker:
    """A process that answers requests; see :func:`bench.nets.serving.serve`.

    Args:
        name: What it is called in messages.
        command: Its command line.
        environment: Variables to add to this process' own.
    """

    def __init__(self, name: str, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        self.name = name
        self._rest = b""
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  (closed with the worker)
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env={**os.environ, **(environment or {})},
            )
        except OSError as error:
            self._errors.close()
            raise LinkError(f"{name} cannot be started: {command[0]}: {error.strerror}", worker=name) from error

    def ask(self, do: str, *, patience: float = _PATIENCE_S, **request: object) -> dict[str, object]:
        """Sends a request and waits for its answer.

        Args:
            do: What is asked for.
            patience: How long to wait [s].
            request: Further fields.

        Raises:
            LinkError: The process has died, or does not answer in time.
        """
        self.tell(do, **request)
        return self.answer(patience)

    def tell(self, do: str, **request: object) -> None:
        """Sends a request; :meth:`answer` waits for its answer.

        Raises:
            LinkError: The process has died.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **request}).encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            raise self._died() from error

    def answer(self, patience: float = _PATIENCE_S) -> dict[str, object]:
        """Waits for the next answer.

        Args:
            patience: How long to wait [s].

        Raises:
            LinkError: The process has died, or does not answer in time.
        """
        assert self._process.stdout is not None
        deadline = monotonic() + patience
        while b"\n" not in self._rest:
            ready, _, _ = select.select([self._process.stdout], [], [], max(0.0, deadline - monotonic()))
            if not ready:
                raise LinkError(f"{self.name} does not answer in {patience:g} s", worker=self.name)
            data = os.read(self._process.stdout.fileno(), 1 << 16)
            if not data:
                raise self._died()
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, object] = json.loads(line)
        return answer

    def close(self) -> None:
        """Ends the process."""
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._errors.close()

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _died(self) -> LinkError:
        code = self._process.wait(_END_S)
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").strip().splitlines() or ["no word"]
        why = next((line for line in reversed(said) if _EXCEPTION.match(line)), said[-1])
        return LinkError(f"{self.name} ended with code {code}: {why}", worker=self.name)


def own(module: str, *options: str, name: str = "") -> Worker:
    """Starts a module of ours, which finds the others where this process does.

    Args:
        module: Its name.
        options: Its options.
        name: What it is called in messages; the name of the module if empty.

    Raises:
        LinkError: It cannot be started.
    """
    return Worker(name or module, [sys.executable, "-m", module, *options], own_path())


def own_path() -> dict[str, str]:
    """Returns the variable that lets a process find modules where this one does."""
    return {"PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)}


def number(answer: Mapping[str, object], key: str) -> float:
    """Returns a number of an answer.

    Raises:
        LinkError: It is none.
    """
    value = answer.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LinkError(f"an answer says {key}={value!r}, which is no number", key=key)
    return float(value)
