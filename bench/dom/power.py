"""Loss of power, without a plug: what a process had not synchronised is on the disk only by chance.

A library that is preloaded (``disk.c``) keeps a second time what the process has synchronised. When the process has
been killed, its folder is made anew from that. Between it and what the operating system had, chance decides for each
sector, each length and each name on its own, as it may where a disk writes in an order of its own.
"""

import shutil
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from random import Random
from tempfile import mkdtemp

from im_core.errors import ConfigError

SECTOR = 512
_NAMES = "names"


class Disk:
    """A disk that forgets, below one folder; what is there at first is on it.

    Args:
        folder: Holds files only; nobody writes there but a process with :attr:`environment`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._keeps = Path(mkdtemp(prefix="im_disk_"))
        lines = []
        for path in folder.iterdir():
            number = path.stat().st_ino
            shutil.copyfile(path, self._keeps / str(number))
            lines.append(f"{number} {path.name}\n")
        (self._keeps / _NAMES).write_text("".join(lines), encoding="utf-8")

    @property
    def environment(self) -> Mapping[str, str]:
        """Variables of the process whose power will be lost."""
        return {"LD_PRELOAD": str(_library()), "DISK_OF": str(self._folder), "DISK_KEEPS": str(self._keeps)}

    def lose_power(self, draw: Random) -> None:
        """Leave in the folder what is there when the power has come back; the process has been killed."""
        there = {path.name: (path.stat().st_ino, path.read_bytes()) for path in self._folder.iterdir()}
        lines = (self._keeps / _NAMES).read_text(encoding="utf-8").splitlines()
        names = {name: int(number) for number, _, name in (line.partition(" ") for line in lines)}
        names |= {name: number for name, (number, _) in there.items() if name not in names and draw.random() < 0.5}
        new = dict(there.values())
        kept = {path.name: path.read_bytes() for path in self._keeps.iterdir()}
        shutil.rmtree(self._keeps)
        for path in self._folder.iterdir():
            path.unlink()
        for name, number in names.items():
            old = kept.get(str(number), b"")
            (self._folder / name).write_bytes(_mixed(old, new.get(number, old), draw))


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
