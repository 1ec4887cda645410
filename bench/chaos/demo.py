"""Signals to ``scripts/demo.sh`` at moments drawn from a seed: does it end, and leave nothing behind?"""

import fcntl
import os
import random
import select
import signal
import subprocess
import tempfile
import termios
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from im_bringup.machine import leftovers
from im_core import clock, names
from im_core.errors import WaitTimeoutError
from im_core.processes.end_signals import END_SIGNALS
from im_core.shm_names import left

_ROOT = Path(__file__).resolve().parents[2]
#: In the environment of all that a trial starts, with the folder of the trial as its value.
_MARK = "IM_TRIAL"
#: What the demo has said when the signal comes, at the latest so long after that [s]; most is of the start.
STAGES = (
    "", "setup: ready", "are kept, for", "start: load", "start: load", "start: configure", "start: configure",
    "start: start", "start: ready", "init_calib", "pose 1 of", "pose 2 of", "calibrate_camera: done", "true error",
)  # fmt: skip
_LATEST_S = 2.0
#: How long the demo may take to come to a stage, and to end after a signal, on a busy computer [s].
_STAGE_S, _END_S = 400.0, 120.0
_POLL_S = 0.05

Signal = Callable[[int], None]
#: What can happen to a script: Ctrl-C reaches all that runs in its terminal, the other two signals the script alone.
SIGNALS: Mapping[str, Signal] = {
    "INT": lambda pid: os.killpg(pid, signal.SIGINT),
    "TERM": lambda pid: os.kill(pid, signal.SIGTERM),
    "HUP": lambda pid: os.kill(pid, signal.SIGHUP),
}
#: Its terminal is closed, in which it runs alone, or from an interactive shell.
TERMINAL, SHELL = "terminal", "shell"
KINDS = (*SIGNALS, TERMINAL, SHELL)


@dataclass(frozen=True)
class DemoTrial:
    """What happens to a demo, and when.

    Attributes:
        seed: All else is drawn from it.
        kind: One of :data:`KINDS`.
        stage: What the demo says before, one of :data:`STAGES`.
        delay_s: How long after that [s].
        again: How often the signal is repeated, a moment later each time.
    """

    seed: int
    kind: str
    stage: str
    delay_s: float
    again: int

    @classmethod
    def of(cls, seed: int) -> "DemoTrial":
        """Draw a trial; kinds take turns."""
        draw = random.Random(seed)
        kind = KINDS[seed % len(KINDS)]
        again = draw.choice((0, 0, 1, 2)) if kind in SIGNALS else 0
        return cls(seed, kind, draw.choice(STAGES), draw.uniform(0.0, _LATEST_S), again)

    def __str__(self) -> str:
        stage = f"{self.delay_s:.2f} s after '{self.stage}'" if self.stage else f"{self.delay_s:.2f} s after its begin"
        return f"{self.seed}: {self.kind}{f' and {self.again} more' if self.again else ''} {stage}"


@dataclass(frozen=True)
class DemoEnd:
    """What came of a trial.

    Attributes:
        code: Exit code of the demo; None: its shell went with the terminal.
        seconds: From the signal to the end of the last process [s].
        left: What is left behind, a sentence for each.
        said: What the demo has said.
    """

    code: int | None
    seconds: float
    left: tuple[str, ...]
    said: str

    def __str__(self) -> str:
        code = "" if self.code is None else f" with {self.code}"
        return f"ended{code} after {self.seconds:.1f} s; left behind: {', '.join(self.left) or 'nothing'}"


def carry_out(trial: DemoTrial, poses: Path, port: int) -> DemoEnd:
    """Run a demo in this ROS domain, and do to it what a trial says; what it leaves behind is ended.

    Raises:
        WaitTimeoutError: The demo has not come to the stage.
    """
    with tempfile.TemporaryDirectory(prefix="im_demo_") as folder:
        demo = _Demo(trial.kind, Path(folder), ["--poses", str(poses), "--port", str(port)])
        try:
            demo.await_words(trial.stage)
            demo.listen(trial.delay_s)
            began = clock.monotonic()
            demo.strike(trial)
            remaining = demo.await_end()
            seconds = clock.monotonic() - began
            found = [*remaining, *_left_in_memory(), *(f"temporary file {name}" for name in os.listdir(demo.temporary))]
            code = demo.ended()
            if code not in (None, 130) and not (code == 0 and STAGES[-1] in demo.said):
                found.append(f"exit code {code}")
            return DemoEnd(code, seconds, tuple(found), demo.said)
        finally:
            demo.close()
            leftovers.end_all()
            leftovers.remove_shared_memory()


class _Demo:
    """A demo in a session of its own, with a terminal that it or its shell owns."""

    def __init__(self, kind: str, folder: Path, arguments: list[str]) -> None:
        self.said = ""
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        self._folder, self._kind = folder, kind
        argv = ["bash", str(_ROOT / "scripts" / "demo.sh"), *arguments]
        if kind == SHELL:
            argv = ["bash", "--norc", "-i", "-c", f"{subprocess.list2cmdline(argv)}; true"]  # else the shell becomes it
        master, slave = os.openpty()
        self._master: int | None = master
        self._process = subprocess.Popen(
            argv,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=_own_terminal,
            env={**os.environ, _MARK: str(folder), "TMPDIR": str(self.temporary)},
        )
        os.close(slave)

    def listen(self, seconds: float) -> None:
        """Take what it says for so long [s]; a terminal that nobody reads would hold it up."""
        deadline = clock.monotonic() + seconds
        while self._master is not None and (rest := deadline - clock.monotonic()) > 0.0:
            if select.select([self._master], [], [], rest)[0]:
                try:
                    self.said += os.read(self._master, 4096).decode(errors="replace")
                except OSError:  # all that had the terminal have ended
                    clock.sleep(rest)

    def await_words(self, words: str) -> None:
        """Wait until it has said something.

        Raises:
            WaitTimeoutError: It has not.
        """
        deadline = clock.monotonic() + _STAGE_S
        while words not in self.said:
            self.listen(_POLL_S)
            if clock.monotonic() > deadline or self.ended() is not None:
                raise WaitTimeoutError(what=f"the demo to say '{words}' after {self.said[-2000:]!r}", seconds=_STAGE_S)

    def strike(self, trial: DemoTrial) -> None:
        """Do what the trial says."""
        if self._kind in SIGNALS:
            for _ in range(1 + trial.again):
                with suppress(ProcessLookupError):
                    SIGNALS[self._kind](self._process.pid)
                self.listen(0.3)
        else:
            self._hang_up()

    def await_end(self) -> list[str]:
        """Wait until all that it has started have ended; those that do not, a sentence for each."""
        deadline = clock.monotonic() + _END_S
        while (alive := self._processes()) and clock.monotonic() < deadline:
            self.listen(_POLL_S)
            clock.sleep(_POLL_S)
        return [f"process {pid} ({name})" for pid, name in alive.items()]

    def ended(self) -> int | None:
        """Exit code of the demo, None while it runs and where it was a shell's."""
        code = self._process.poll()
        return None if self._kind == SHELL else code

    def close(self) -> None:
        """End what is left of it."""
        self._hang_up()
        for pid in self._processes():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._process.wait()

    def _hang_up(self) -> None:
        if self._master is not None:
            os.close(self._master)
            self._master = None

    def _processes(self) -> dict[int, str]:
        """Processes that were started by it, with their names; those that have ended are none."""
        self._process.poll()
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if f"{_MARK}={self._folder}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found[int(folder.name)] = (folder / "comm").read_text().strip()
        return found


def _own_terminal() -> None:
    """Take standard input for the terminal of this session, and heed signals which ``nohup`` or a shell had ignored."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _left_in_memory() -> list[str]:
    """What of the machine of this ROS domain is left in shared memory and among sockets, a sentence for each."""
    prefix = f"{names.instance()}_"
    sockets = [line.split()[-1] for line in Path("/proc/net/unix").read_text(encoding="utf-8").splitlines()]
    mine = (f"@{prefix}", f"{names.run_dir()}/")
    return [*(str(path) for path in left(prefix)), *(f"socket {name}" for name in sockets if name.startswith(mine))]
