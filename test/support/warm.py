"""Processes that begin as copies of one that has imported what they run, as the nodes of a machine do.

To import it is most of what the start of a node takes.
"""

import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
from pathlib import Path
from typing import Self


class Warm:
    """Runs modules as ``python -m`` does, in processes that end with the block at the latest."""

    def __init__(self, *modules: str) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self._original = subprocess.Popen(
            [sys.executable, "-m", "support.warm", *modules],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._original.communicate()
        assert self._original.returncode == 0

    def start(self, module: str, *arguments: object, log: Path | None = None) -> "Copy":
        """Runs a module with the environment of this moment; what it says is added to a file, or to what tests say."""
        argv = [str(argument) for argument in arguments]
        begin = {"module": module, "argv": argv, "environment": dict(os.environ), "log": log and str(log)}
        return Copy(self, self.ask(begin))

    def ask(self, question: object) -> int:
        """What the original answers."""
        print(json.dumps(question), file=self._original.stdin, flush=True)
        return int(self._original.stdout.readline())


class Copy:
    """A process; it is nobody else's until it was waited for.

    Attributes:
        pid: Process id.
    """

    def __init__(self, warm: Warm, pid: int) -> None:
        self._warm, self.pid, self._ended = warm, pid, False

    def kill(self) -> None:
        """Ends it with SIGKILL; nothing happens if it was waited for."""
        if not self._ended:
            os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> None:
        """Waits for its end."""
        if not self._ended:
            self._warm.ask(self.pid)
            self._ended = True


def _begin(module: str, argv: list[str], environment: dict[str, str], log: str | None) -> None:
    """The rest of the life of a copy."""
    os.setsid()
    said = 2 if log is None else os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number, descriptor in enumerate((os.open(os.devnull, os.O_RDONLY), said, said)):
        os.dup2(descriptor, number)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv[1:] = argv
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _serve(modules: list[str]) -> None:
    """Begins copies, and waits for them, until nobody asks any more."""
    for module in modules:
        importlib.import_module(module)
    running = set()
    while line := sys.stdin.readline():
        asked = json.loads(line)
        if isinstance(asked, int):
            os.waitpid(asked, 0)
            running.discard(asked)
            print(0, flush=True)
        elif pid := os.fork():
            running.add(pid)
            print(pid, flush=True)
        else:
            _begin(**asked)
            return
    for pid in running:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


if __name__ == "__main__":
    _serve(sys.argv[1:])
