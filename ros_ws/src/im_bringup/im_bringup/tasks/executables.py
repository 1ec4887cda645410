"""Where the executables of the workspace's packages are."""

import os
from pathlib import Path

from im_core.errors import NotFoundError


def prefixes() -> list[Path]:
    """Install prefixes of the sourced workspaces, the nearest first."""
    return [Path(text) for text in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if text]


def packages() -> list[str]:
    """Names of the packages of colcon workspaces that have executables, sorted."""
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


def _programs(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if path.is_file() and os.access(path, os.X_OK)]
    except OSError:
        return []
