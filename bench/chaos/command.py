"""The command that the machine is given, ``calibrate_camera`` with few poses, or waited for, as users do it."""

import json
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from bench.chaos.hosts import Host
from im_core import clock

_POLL_S = 0.02


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        code: Exit code, None if it hung and was killed.
        said: Its last sentence on standard error.
        report: What it found; empty unless it succeeded.
        ended: Monotonic time of its end [s].
    """

    code: int | None
    said: str
    report: dict[str, object]
    ended: float

    @property
    def success(self) -> bool:
        """Whether it says that it succeeded."""
        return self.code == 0


class Command:
    """A running ``calibrate_camera``.

    Args:
        poses: File of the poses; None: it has been given already.
        number: Of the command that has been given.
        host: Where it is given; None: on this computer.
    """

    def __init__(self, poses: Path | None = None, number: int = 0, host: Host | None = None) -> None:
        given = ("calibrate_camera", "--poses-file", str(poses)) if poses else ("--attach", str(number))
        argv = [sys.executable, "-m", "im_bringup.ros.run_command", *given, "--json"]
        self.began = clock.monotonic()
        self._process = subprocess.Popen(
            argv if host is None else host.argv(*argv),
            env=None if host is None else host.environment({}),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._lines: list[str] = []
        self._printed: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=(self._process.stderr, self._lines), daemon=True),
            threading.Thread(target=self._read, args=(self._process.stdout, self._printed), daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def steps(self) -> int:
        """Lines of progress so far."""
        return sum(line.startswith("[") for line in self._lines)

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def await_step(self, step: int, timeout_s: float) -> None:
        """Wait until so many lines of progress are there, it has ended, or ``timeout_s`` [s] are over."""
        deadline = clock.monotonic() + timeout_s
        while self.steps < step and self.running and clock.monotonic() < deadline:
            clock.sleep(_POLL_S)

    def outcome(self, timeout_s: float) -> Outcome:
        """Wait for its end, at most ``timeout_s`` [s]; one that hangs is killed."""
        try:
            code: int | None = self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            code = None
        ended = clock.monotonic()
        for reader in self._readers:
            reader.join(timeout=10.0)
        said = next((line for line in reversed(self._lines) if not line.startswith("[")), "")
        said, printed = said.partition(": ")[2] or said, {}
        if code == 0:
            try:
                printed = json.loads("".join(self._printed))
            except ValueError as error:  # then nothing was found, and that is no success
                said = f"what it printed is no JSON: {error}: {''.join(self._printed)[:200]}"
        return Outcome(code, said, printed.get("report", printed), ended)

    @staticmethod
    def _read(stream: IO[str] | None, lines: list[str]) -> None:
        assert stream is not None, "both streams are pipes"
        lines.extend(line.rstrip() for line in stream)
