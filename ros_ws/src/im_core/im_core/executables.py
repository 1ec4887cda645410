"""Where the executables of the workspace's packages are, and ``run PACKAGE EXECUTABLE ARGS...``, which becomes one."""

import os
import runpy
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from im_core.errors import NotFoundError
from im_core.files import FileError, read_bytes
from im_core.processes.host_record import reach_machine

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
_LARGEST_SCRIPT = 2**14
"""Bytes of a console script, which only calls a function."""


def prefixes() -> list[Path]:
    """Install prefixes of the sourced workspaces, the nearest first."""
    return [Path(text) for text in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if text]


def packages() -> list[str]:
    """Return the names of the packages of colcon workspaces with executables, sorted."""
    workspaces = [Path(text) for text in os.environ.get("COLCON_PREFIX_PATH", "").split(os.pathsep) if text]
    near = [prefix for prefix in prefixes() if any(prefix.is_relative_to(workspace) for workspace in workspaces)]
    return sorted({folder.name for prefix in near for folder in (prefix / "lib").glob("*") if _programs(folder)})


def executables(package: str) -> list[str]:
    """Names of the executables of a package, sorted.

    Raises:
        NotFoundError: There is no such package, or it has none.
    """
    for prefix in prefixes():
        programs = _programs(prefix / "lib" / package)
        if programs:
            return sorted(program.name for program in programs)
    raise NotFoundError(kind="package with executables", name=package, known=packages())


def path_of(package: str, executable: str) -> Path:
    """Path of an executable.

    Raises:
        NotFoundError: There is no such package or executable; the message lists those there are.
    """
    known = executables(package)
    if executable not in known:
        raise NotFoundError(kind=f"executable of {package}", name=executable, known=known)
    return next(path for path in (prefix / "lib" / package / executable for prefix in prefixes()) if path.is_file())


def main() -> int:
    """Run the executable; with less than two arguments, list the choices.

    Ctrl-C ends the executable without a traceback, also while it is loaded: ``scripts/im`` blocks it until then.

    Returns:
        0 after a listing, 2 if there is no such thing, 130 after Ctrl-C.
    """
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        return _run(sys.argv[1:])
    except KeyboardInterrupt:
        return INTERRUPTED


def _run(arguments: Sequence[str]) -> int:
    try:
        if not arguments:
            for package in packages():
                print(f"{package}: {' '.join(executables(package))}")
            return 0
        if len(arguments) == 1 or arguments[1] in ("-h", "--help"):
            print("\n".join(executables(arguments[0])))
            return 0
        path = path_of(arguments[0], arguments[1])
    except NotFoundError as error:
        print(f"run: {error.message}", file=sys.stderr)
        return 2
    reach_machine()
    _become(path, arguments[2:])
    return 0


def _become(path: Path, arguments: Sequence[str]) -> None:
    """Run a script of this Python in this process; any other program takes its place."""
    try:
        own = read_bytes(path, _LARGEST_SCRIPT).startswith(f"#!{sys.executable}\n".encode())
    except FileError:
        own = False
    sys.argv = [str(path), *arguments]
    if own:
        runpy.run_path(str(path), run_name="__main__")
    else:
        os.execv(path, sys.argv)


def _programs(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if path.is_file() and os.access(path, os.X_OK)]
    except OSError:
        return []


if __name__ == "__main__":
    sys.exit(main())
