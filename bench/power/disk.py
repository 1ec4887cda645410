"""A disk that forgets: what processes had not synchronised when their power went is on it only by chance.

A library that is preloaded (``disk.c``) keeps a second time what the processes have synchronised. When they have been
killed, their folder is made anew from that. Between it and what the operating system had, chance decides for each
sector, each length and each name on its own, as it may where a disk writes in an order of its own.
"""

import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from tempfile import mkdtemp

from im_core.errors import ConfigError

SECTOR = 512


@dataclass(frozen=True)
class _Entry:
    """What a name in a folder stands for: a folder or a file, by the number of its inode."""

    is_folder: bool
    number: int


class Disk:
    """A disk that forgets, below one folder; what is there at first is on it.

    Args:
        folder: Holds folders and files only, and nobody writes there but processes with :attr:`environment`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._keeps = Path(mkdtemp(prefix="im_disk_", dir=self._folder.parent))  # where a file can have a second name
        for path in (self._folder, *self._folder.rglob("*")):
            kept = self._keeps / str(path.stat().st_ino)
            if path.is_dir():
                lines = [f"{'d' if each.is_folder else 'f'} {each.number} {name}\n" for name, each in _names(path)]
                kept.write_text("".join(lines), encoding="utf-8")
            else:
                shutil.copyfile(path, kept)
                (self._keeps / f"held.{kept.name}").hardlink_to(path)

    @property
    def environment(self) -> Mapping[str, str]:
        """Variables of the processes whose power will be lost."""
        return {"LD_PRELOAD": str(_library()), "DISK_OF": str(self._folder), "DISK_KEEPS": str(self._keeps)}

    def lose_power(self, draw: Random) -> None:
        """Leave in the folder what is there when the power has come back; the processes have been killed."""
        before = self._folder.with_name(f"{self._folder.name}.before")
        self._folder.rename(before)
        there = {path.stat().st_ino: path for path in (before, *before.rglob("*"))}
        self._remake(self._folder, before.stat().st_ino, there, draw)
        shutil.rmtree(before)
        self.close()

    def close(self) -> None:
        """Remove what was kept."""
        shutil.rmtree(self._keeps)

    def _remake(self, path: Path, number: int, there: Mapping[int, Path], draw: Random) -> None:
        """Make a folder as it is on the disk.

        Args:
            path: Where.
            number: Its number.
            there: What the operating system had, by number.
            draw: Decides.
        """
        path.mkdir()
        kept = self._keeps / str(number)
        names = dict(_parsed(kept.read_text(encoding="utf-8"))) if kept.exists() else {}
        for name, entry in _names(there[number]) if number in there else ():
            if names.get(name) != entry and draw.random() < 0.5:  # a name that is new, or stands for something else
                names[name] = entry
        for name, entry in names.items():
            if entry.is_folder:
                self._remake(path / name, entry.number, there, draw)
                continue
            kept = self._keeps / str(entry.number)
            old = kept.read_bytes() if kept.exists() else b""
            new = there[entry.number].read_bytes() if entry.number in there else old
            (path / name).write_bytes(_mixed(old, new, draw))


def _names(folder: Path) -> Iterator[tuple[str, _Entry]]:
    for path in folder.iterdir():
        yield path.name, _Entry(path.is_dir(), path.stat().st_ino)


def _parsed(lines: str) -> Iterator[tuple[str, _Entry]]:
    for line in lines.splitlines():
        kind, number, name = line.split(" ", 2)
        yield name, _Entry(kind == "d", int(number))


def _mixed(old: bytes, new: bytes, draw: Random) -> bytes:
    """A content of which some sectors are old and some new; where the old one ended and nothing was written, zeros."""
    length = draw.choice((len(old), len(new), draw.randint(min(len(old), len(new)), max(len(old), len(new)))))
    share = draw.random()
    sectors = []
    for at in range(0, length, SECTOR):
        content = new if draw.random() < share else old
        sectors.append(content[at : at + SECTOR].ljust(SECTOR, b"\0"))
    return b"".join(sectors)[:length]


@cache
def _library() -> Path:
    """The library, built.

    Raises:
        ConfigError: It cannot be.
    """
    source, built = Path(__file__).with_name("disk.c"), Path(mkdtemp(prefix="im_disk_")) / "disk.so"
    command = ["gcc", "-shared", "-fPIC", "-O1", "-Wall", "-o", str(built), str(source), "-ldl", "-lpthread"]
    try:
        made = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise ConfigError(f"the library of a disk that forgets needs gcc: {error}") from error
    if made.returncode != 0:
        raise ConfigError(f"the library of a disk that forgets cannot be built: {made.stderr.strip()}")
    return built
