"""Keeps built message packages in the user's cache folder, so that a second clone need not compile the same again.

::

    python message_cache.py key ROOT FOLDER...          the key of the packages in these folders, on standard output
    python message_cache.py fetch ROOT KEY NAME...      puts them into ROOT/ros_ws/install
    python message_cache.py store ROOT KEY NAME...      takes them from there

Of what is fetched, nothing but the paths of the clone differs from what a build here would give: the key is a hash of
all that goes into a build. The cache is ``$IM_CACHE``, else ``$XDG_CACHE_HOME/im``, else ``~/.cache/im``. It keeps the
packages that were used last. Exit codes: 0 done, 1 not in the cache, or not to be kept there (said why), 2 bad usage.
"""

from __future__ import annotations

import compileall
import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from collections.abc import Iterable
from pathlib import Path

KEPT = 6
"""Entries that stay, of 3 to 5 MB each."""

# Folders of a clone that its built packages name, and what stands for them in the cache.
PLACES = {"ros_ws": b"@IM_ROS_WS@", ".venv": b"@IM_VENV@"}


class NotRelocatableError(Exception):
    """A built file names the folder of the clone where a text cannot be replaced."""


class DamagedError(Exception):
    """An entry of the cache is not what was stored."""


def folder() -> Path:
    """Returns the folder of the cache; it need not exist."""
    if os.environ.get("IM_CACHE"):
        return Path(os.environ["IM_CACHE"]) / "messages"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "im" / "messages"


def tools() -> list[str]:
    """Returns what compiles here: Python, compilers, their flags, the C library, the processor."""
    found = [sys.version, sysconfig.get_paths()["include"], platform.machine(), *platform.libc_ver()]
    for program in (os.environ.get("CC", "cc"), os.environ.get("CXX", "c++"), "gcc", "g++"):
        path = shutil.which(program.split()[0]) if program else None
        told = subprocess.run([path, "--version"], capture_output=True, text=True, check=False).stdout if path else ""
        found += [program, str(path and Path(path).resolve()), told]
    flags = ("CFLAGS", "CXXFLAGS", "CPPFLAGS", "LDFLAGS", "CPATH", "C_INCLUDE_PATH", "CPLUS_INCLUDE_PATH")
    return found + [f"{name}={os.environ.get(name)}" for name in flags]


def key(root: Path, folders: Iterable[Path]) -> str:
    """Returns the hash of all that goes into a build of the packages.

    Args:
        root: The clone; its scripts, its lock and the environment that was made of it count.
        folders: Of the packages' sources.
    """
    names = ("requirements.lock", *(f"scripts/{name}.py" for name in ("underlay", "im_rosidl", "message_cache")))
    sources = {name: root / name for name in (*names, "scripts/setup.sh")}
    for package in folders:
        files = (path for path in package.rglob("*") if path.is_file())
        sources |= {f"{package.name}/{path.relative_to(package)}": path for path in files}
    digest = hashlib.sha256(repr(tools()).encode())
    for name, path in sorted(sources.items()):
        digest.update(f"\0{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}".encode())
    return digest.hexdigest()


def replaced(data: bytes, old_by_new: dict[bytes, bytes], name: str) -> bytes:
    """Returns the content of a file with texts replaced.

    Raises:
        NotRelocatableError: A text is in a file that is not a text.
    """
    for old, new in old_by_new.items():
        if old not in data:
            continue
        if b"\0" in data:
            raise NotRelocatableError(f"{name} has {os.fsdecode(old)} in it, and is not a text")
        data = data.replace(old, new)
    return data


def store(root: Path, entry: str, names: Iterable[str]) -> Path:
    """Keep built packages.

    Args:
        root: The clone; the packages are in ``ros_ws/install``.
        entry: Their key.
        names: The packages.

    Returns:
        The file of the entry, complete under its name or not there.

    Raises:
        NotRelocatableError: A package works in this clone only.
    """
    paths = {os.fsencode(root / place): mark for place, mark in PLACES.items()}
    install, packed = root / "ros_ws" / "install", io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz", compresslevel=1) as archive:
        for path in sorted(path for name in names for path in (install / name).rglob("*")):
            if path.is_dir() or path.suffix == ".pyc":
                continue
            data = replaced(path.read_bytes(), paths, str(path))
            member = tarfile.TarInfo(str(path.relative_to(install)))
            member.size, member.mode = len(data), path.stat().st_mode & 0o777
            archive.addfile(member, io.BytesIO(data))
    content = packed.getvalue()
    cache = folder()
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache, prefix=".new-") as new:
        path = Path(new) / entry
        path.write_bytes(hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
        os.replace(path, cache / entry)
    for old in sorted(cache.glob("[0-9a-f]*"), key=lambda path: path.stat().st_mtime)[:-KEPT]:
        old.unlink(missing_ok=True)
    return cache / entry


def fetch(root: Path, entry: str, names: Iterable[str]) -> Path | None:
    """Put kept packages into a clone, in the place of those that are there.

    Args:
        root: The clone; the packages come into ``ros_ws/install``.
        entry: Their key.
        names: The packages.

    Returns:
        The file of the entry, or None if there is none.

    Raises:
        DamagedError: The entry is not what was stored; it is removed.
    """
    path = folder() / entry
    try:
        told, _, content = path.read_bytes().partition(b"\n")
        os.utime(path)
    except FileNotFoundError:
        return None
    if hashlib.sha256(content).hexdigest().encode() != told:
        path.unlink(missing_ok=True)
        raise DamagedError(f"{path} was damaged and is removed")
    marks = {mark: os.fsencode(root / place) for place, mark in PLACES.items()}
    install = root / "ros_ws" / "install"
    install.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=install, prefix=".new-") as new:
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as archive:
            archive.extractall(new, filter="data")
        for file in (file for file in Path(new).rglob("*") if file.is_file() and file.suffix != ".so"):
            file.write_bytes(replaced(file.read_bytes(), marks, str(file)))
        for name in names:
            shutil.rmtree(install / name, ignore_errors=True)
            os.replace(Path(new) / name, install / name)
    for name in names:
        for packages in (install / name / "lib").glob("python3*/site-packages"):
            compileall.compile_dir(packages, quiet=2)
    return path


def main(arguments: list[str]) -> int:
    """Do what the command line says."""
    match arguments:
        case ["key", root, *folders] if folders:
            print(key(Path(root), map(Path, folders)))
            return 0
        case ["fetch" | "store" as what, root, entry, *names] if names:
            try:
                path = {"fetch": fetch, "store": store}[what](Path(root), entry, names)
            except (DamagedError, NotRelocatableError, OSError) as error:
                print(f"{what}: {error}", file=sys.stderr)
                return 1
            print(path or "")
            return 0 if path else 1
    print(__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
