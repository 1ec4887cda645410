"""``supervisor``: parent of a bootstrap or an agent; after a death or a hang another one is started with all tasks.

The tasks of a host end with the bootstrap that started them. A new bootstrap starts them all anew; their journals are
kept, so that the nets go on where they were. What ends with an exit code has ended on purpose, or would end so again;
it is not started again. A machine that is started again has nobody who waits for it: where it does not become ready
either, it is tried :data:`MOST_TRIES` times, and then the log says that it is given up. An agent of another host counts
as ready once it has lived for :data:`LASTING_S`: it waits for its bootstrap as long as need be.
"""

import os
import signal
import sys
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from im_bringup.tasks.memory_limit import refused
from im_bringup.tasks.receivers import Receivers
from im_bringup.tasks.standstill import Standstill
from im_core import clock, names
from im_core.errors import ImError
from im_core.patience import Silence
from im_core.processes import loop_heartbeat as pulse_memory
from im_core.processes.end_signals import heed_end_signals
from im_core.processes.loop_heartbeat import Pulse
from im_core.processes.process import ChildProcess
from im_core.processes.startup import start_timeout_s

T = TypeVar("T")

#: How often in a row a machine that was ready is started again and does not become ready.
MOST_TRIES = 3
LASTING_S = 30.0
#: How long, and how often, what the operating system refuses is tried again, such as where /dev/shm is full [s].
_REFUSED_S, _AGAIN_S = 60.0, 1.0
#: How long the tasks of a dead bootstrap may take to end by themselves [s].
_ORDERLY_S = 4.0
_POLL_S = 0.05
#: How often it is looked whether a bootstrap hangs; its end is told at once [s].
_LOOK_S = 0.25
#: A bootstrap that tells nothing of its loop for longer, though it could, was stopped or is stuck [s].
SILENCE_S = 30.0
#: How long a bootstrap that hangs may take to write its stacks before it is killed [s].
_ABORT_S = 2.0


class BootstrapKeeper:
    """Supervisor: runs a bootstrap, and another one if the first is killed after the machine was ready; or an agent.

    Args:
        argv: Program and arguments of the bootstrap or the agent.
        agent: Whether it is an agent: it ends with this process, and writes no record of a machine.
    """

    def __init__(self, argv: list[str], agent: bool = False) -> None:
        self._argv, self._agent = argv, agent
        self._child: ChildProcess | None = None
        self._stopped: signal.Signals | None = None
        self._signals: deque[signal.Signals] = deque()  # to pass on
        self._tries = 0  # since the machine was ready last

    def stop(self, number: signal.Signals) -> None:
        """Pass a signal on soon and end with the bootstrap; from any thread."""
        self._stopped = number
        self._signals.append(number)

    def run(self) -> int:
        """Run until a bootstrap exits; return the exit code, 1 if killed and not started again."""
        while self._stopped is None:
            try:
                self._child, hang = self._spawn()
            except OSError as error:
                if not self._tries:  # who starts the machine is told
                    raise
                if not self._make_way(f"could not be started ({error})"):
                    return 1
                continue
            failure, code = "", None
            began, log_begin = clock.monotonic(), _log_size()
            while code is None:
                while self._signals:
                    self._child.send_signal(self._signals.popleft())
                self._child.await_end(_LOOK_S)
                code = self._child.poll()
                if code is None and self._stopped is None and (failure := self._failure(hang, began)):
                    code = self._end(self._child)
            if code >= 0 and not (code > 0 and self._tries and self._stopped is None):
                return code
            if self._stopped is not None or not self._make_way(failure or _how(code, log_begin)):
                return 1
        return 1

    def _spawn(self) -> "tuple[ChildProcess, Hang]":
        pulse = Pulse.create()
        try:
            environment = {**os.environ, pulse_memory.VARIABLE: str(pulse.descriptor)}
            ends = signal.SIGTERM if self._agent else None
            child = ChildProcess(self._argv, environment=environment, death_signal=ends, inherit=[pulse.descriptor])
        finally:
            pulse.keep()
        return child, Hang(child.pid, pulse)

    @staticmethod
    def _end(child: ChildProcess) -> int:
        """End a hanging bootstrap; return the killing signal as a negative number."""
        child.send_signal(signal.SIGABRT)  # writes the stacks of its threads; one that is stopped writes nothing
        child.await_end(_ABORT_S)
        child.send_signal(signal.SIGKILL)
        while (code := child.poll()) is None:
            clock.sleep(_POLL_S)
        return min(code, -1)

    def _failure(self, hang: "Hang", began: float) -> str:
        """Return the fault of the running bootstrap as a clause; empty if there is none."""
        found = hang.found()
        return f"hung ({found})" if found else self._not_ready(began)

    def _not_ready(self, began: float) -> str:
        """Return why a restarted machine does not become ready, as a clause; empty if ready or still in time."""
        if self._agent and clock.monotonic() - began > LASTING_S:
            self._tries = 0
        if self._agent or not self._tries:
            return ""
        from im_bringup.machine import machine_state as machine

        record = _tried(machine.read)
        if record is not None and self._child is not None and record.pid == self._child.pid:
            if record.state == machine.READY:
                self._tries = 0
                return ""
            if record.state == machine.FAILED:
                return f"failed to start its tasks: {'; '.join(record.missing)}"
        late = clock.monotonic() - began > start_timeout_s()
        return f"was not ready after {start_timeout_s():g} s" if late else ""

    def _make_way(self, how: str) -> bool:
        """Make way for another bootstrap: end the tasks of the dead one, and remove leftovers in shared memory.

        Args:
            how: What became of the dead one.

        Returns:
            Whether the machine is started again; it is if it was ready.
        """
        # loaded when they are used: they are most of a process that else waits, with the machine, all its life
        from im_bringup.machine import leftovers
        from im_bringup.machine import machine_state as machine
        from im_core.processes.procfs import ProcessId

        record = None if self._agent else _tried(machine.read)
        if record is not None and record.state == machine.READY:
            self._tries = 0
        elif not self._tries and not self._agent:
            _say(f"the bootstrap {how} before the machine was ready, which is not started again")
            return False
        self._tries += 1
        again = self._tries <= MOST_TRIES
        what, whole = ("agent", "it") if self._agent else ("bootstrap", "the machine")
        sentence = f"the {what} {how}; {whole} is {'started again' if again else 'given up'}"
        _say(sentence)
        me = ProcessId.current()
        if record is not None:
            record = replace(record, pid=me.pid, start=me.start, state=machine.STARTING, missing=[sentence])
            self._insist(lambda: machine.write(record))
        leftovers.await_end(_ORDERLY_S, goes_on=lambda: self._stopped is None)
        leftovers.end_all()
        leftovers.remove_shared_memory()
        if again and record is not None:
            self._insist(lambda: machine.write(record))
        return again

    def _insist(self, do: Callable[[], None]) -> None:
        """Run an operation; if refused (for example for lack of room), retry for a while and report the failure."""
        deadline, said = clock.monotonic() + _REFUSED_S, ""
        while self._stopped is None:
            try:
                do()
                return
            except (ImError, OSError) as error:
                if str(error) != said:
                    said = str(error)
                    _say(said)
            if clock.monotonic() > deadline:
                return
            clock.sleep(_AGAIN_S)


def _tried(read: Callable[[], T | None]) -> T | None:
    """Read the record of the machine; on a failure print the reason, and return None."""
    try:
        return read()
    except (ImError, OSError) as error:
        _say(str(error))
        return None


def _log_size() -> int:
    log = _log()
    return log.stat().st_size if log.exists() else 0


def _log() -> Path:
    """Where the bootstrap writes."""
    return names.run_dir() / "log" / "bootstrap.log"


def _how(code: int, log_begin: int) -> str:
    if refused(code, _log(), log_begin):
        return "asked for more memory than its limit"
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def _say(sentence: str) -> None:
    with suppress(OSError):  # its log is full; what was not written comes with the next sentence
        print(f"[supervisor]: {sentence}", flush=True)


class Hang:
    """Detector of a hanging bootstrap: hung like a task, or stopped, which only the supervisor can see.

    Args:
        pid: The bootstrap.
        pulse: What it tells of its loop.
    """

    def __init__(self, pid: int, pulse: Pulse) -> None:
        self._pid, self._pulse = pid, pulse
        self._standstill, self._receivers = Standstill(pid, pulse), Receivers(pid)
        self._ticks, self._silence = 0, Silence(pid)

    def found(self) -> str:
        """Return why the bootstrap counts as hung, as a clause; empty if not hung."""
        now = clock.monotonic()
        if fault := self._standstill.found(now) or self._receivers.found(now):
            return fault
        ticks = self._pulse.last().ticks
        if ticks == 0 or ticks != self._ticks:  # it has not come to telling, or it has just told
            self._ticks, self._silence = ticks, Silence(self._pid, longest_look_s=2.0 * _LOOK_S)
            return ""
        silent_s = self._silence.look()
        return f"nothing was heard of it for {silent_s:.0f} s" if silent_s > SILENCE_S else ""


def main() -> int:
    """Run the command: ``--agent`` for an agent, a program and arguments."""
    agent = sys.argv[1:2] == ["--agent"]
    supervisor = BootstrapKeeper(sys.argv[1 + agent :], agent)
    heed_end_signals(supervisor.stop)
    return supervisor.run()


if __name__ == "__main__":
    sys.exit(main())
