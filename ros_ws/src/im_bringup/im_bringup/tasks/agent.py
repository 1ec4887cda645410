"""The agent of a host: starts the processes of its tasks, starts again what died, and stops all of them in order."""

import ctypes
import os
import signal
import subprocess
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from im_core import clock

RESPAWN_DELAY_S = 1.0
RESPAWN_LIMIT = 5
RESPAWN_WINDOW_S = 60.0

#: Shutdown: how long one process may hold up the next, and all of them together; when the signals get harder [s].
_TURN_S = 0.5
_ALL_TURNS_S = 1.8
_TERM_AFTER_S = 2.6
_KILL_AFTER_S = 3.5

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


class Child(Protocol):
    """What the agent needs of a process; ``subprocess.Popen`` has it."""

    pid: int

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""
        ...

    def send_signal(self, sig: int) -> None:
        """Send a signal; nothing happens if it ended."""
        ...


@dataclass(frozen=True)
class Command:
    """How the process of a task is started.

    Attributes:
        name: Symbolic name of the task.
        argv: Program and arguments.
        log: File that takes what it prints.
    """

    name: str
    argv: Sequence[str]
    log: Path


@dataclass(frozen=True)
class Started:
    """A process was started."""

    name: str
    pid: int
    restarts: int


@dataclass(frozen=True)
class Died:
    """A process ended by itself.

    Attributes:
        name: Task.
        sentence: How it ended, its last words, and what follows.
    """

    name: str
    sentence: str


@dataclass
class _Slot:
    command: Command
    child: Child | None = None
    restarts: int = 0
    respawn_at: float | None = None
    respawned: deque[float] = field(default_factory=deque)


Spawn = Callable[[Command, Mapping[str, str]], Child]


def spawn_process(command: Command, environment: Mapping[str, str]) -> Child:
    """Start a process in a session of its own; it is ended by the kernel if this thread dies."""
    command.log.parent.mkdir(parents=True, exist_ok=True)
    with command.log.open("ab") as log:
        return subprocess.Popen(
            command.argv,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=dict(environment),
            start_new_session=True,
            preexec_fn=_end_with_parent,
        )


def _end_with_parent() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Agent:
    """Processes of one host. Call :meth:`poll` often, from the thread that called :meth:`start`.

    Args:
        commands: One for each task, in starting order.
        environment: Environment of the processes.
        spawn: Starts a process.
    """

    def __init__(
        self, commands: Sequence[Command], environment: Mapping[str, str], spawn: Spawn = spawn_process
    ) -> None:
        self._slots = {command.name: _Slot(command) for command in commands}
        self._environment = dict(environment)
        self._spawn = spawn
        #: Whether a task that died is started again.
        self.respawn = False

    def start(self) -> list[Started]:
        """Start all processes."""
        return [self._start(slot) for slot in self._slots.values()]

    def poll(self, now: float) -> list[Started | Died]:
        """Notice processes that ended, and start again those whose time has come.

        Args:
            now: Monotonic time [s].
        """
        events: list[Started | Died] = []
        for slot in self._slots.values():
            if slot.child is not None and (code := slot.child.poll()) is not None:
                slot.child = None
                events.append(Died(slot.command.name, self._plan(slot, code, now)))
            elif slot.respawn_at is not None and now >= slot.respawn_at:
                slot.respawn_at = None
                slot.restarts += 1
                slot.respawned.append(now)
                events.append(self._start(slot))
        return events

    def running(self) -> list[str]:
        """Names of the tasks whose process runs, in starting order."""
        return [name for name, slot in self._slots.items() if slot.child is not None and slot.child.poll() is None]

    def shut_down(self) -> list[str]:
        """Stop all processes, the last started first; takes less than 4 s.

        Each gets SIGINT when its turn comes, which is when the one before it has ended or has had its share of 1.8 s.
        Who has not ended after 2.6 s gets SIGTERM, after 3.5 s SIGKILL.

        Returns:
            Names of the tasks that had to be killed.
        """
        self.respawn = False
        for slot in self._slots.values():
            slot.respawn_at = None
        began = clock.monotonic()
        children = [(name, slot.child) for name, slot in self._slots.items() if slot.child is not None]
        turn = min(_TURN_S, _ALL_TURNS_S / max(1, len(children)))
        for _, child in reversed(children):
            _signal(child, signal.SIGINT)
            _wait([child], clock.monotonic() + turn)
        everyone = [child for _, child in children]
        _wait(everyone, began + _TERM_AFTER_S)
        for child in everyone:
            _signal(child, signal.SIGTERM)
        _wait(everyone, began + _KILL_AFTER_S)
        killed = [name for name, child in children if child.poll() is None]
        for child in everyone:
            _signal(child, signal.SIGKILL)
        _wait(everyone, began + _KILL_AFTER_S + 0.4)
        return killed

    def _start(self, slot: _Slot) -> Started:
        slot.child = self._spawn(slot.command, self._environment)
        return Started(slot.command.name, slot.child.pid, slot.restarts)

    def _plan(self, slot: _Slot, code: int, now: float) -> str:
        words = last_words(slot.command.log)
        sentence = f"it {_how(code)}{': ' + words if words else ''} (log: {slot.command.log})"
        if not self.respawn:
            return sentence
        while slot.respawned and now - slot.respawned[0] > RESPAWN_WINDOW_S:
            slot.respawned.popleft()
        if len(slot.respawned) >= RESPAWN_LIMIT:
            return f"{sentence}; it was started again {RESPAWN_LIMIT} times within a minute and is given up"
        slot.respawn_at = now + RESPAWN_DELAY_S
        return f"{sentence}; it is started again in {RESPAWN_DELAY_S:g} s"


def last_words(log: Path, most_bytes: int = 4096) -> str:
    """The last line of a log that is not empty, or an empty string."""
    try:
        with log.open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - most_bytes))
            text = file.read().decode(errors="replace")
    except OSError:
        return ""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def _how(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    return f"was killed by {signal.Signals(-code).name}"


def _signal(child: Child, number: int) -> None:
    if child.poll() is None:
        child.send_signal(number)


def _wait(children: Sequence[Child], deadline: float) -> None:
    while any(child.poll() is None for child in children) and clock.monotonic() < deadline:
        clock.sleep(0.01)
