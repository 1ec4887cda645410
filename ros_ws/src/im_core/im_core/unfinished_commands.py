"""Unfinished commands of a task, in a file for the inspection of the remains of a killed machine."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from im_core.errors import DataError
from im_core.files import MEBIBYTE, make_folder, read_text, write_whole
from im_core.text.bounded_json import read_json

MISSIONS = "missions"
"""Folder in that of a machine's run: what former missions have left, each in a folder of its own."""

_FOLDER = "commands"


@dataclass(frozen=True)
class OpenCommandNote:
    """Note of an unfinished command.

    Attributes:
        task: That runs it.
        number: Its number there.
        symbol: What it is called.
        progress: Its progress 0..1 when its task was stopped, negative where unknown.
    """

    task: str
    number: int
    symbol: str
    progress: float = -1.0

    def __str__(self) -> str:
        share = f", {100 * self.progress:.0f} %" if self.progress >= 0 else ""
        return f"{self.symbol} (number {self.number} of {self.task}{share})"


def note(run_dir: Path, task: str, commands: Sequence[OpenCommandNote]) -> None:
    """Write down which commands a task has not ended.

    Raises:
        StoreError: It cannot be written.
    """
    content = [[command.number, command.symbol, command.progress] for command in commands]
    write_whole(make_folder(run_dir / _FOLDER) / f"{task}.json", json.dumps(content))


def noted(run_dir: Path) -> list[OpenCommandNote]:
    """Read the commands unfinished at the end of the machine of a run folder; a bad file gives none."""
    found = []
    for file in sorted((run_dir / _FOLDER).glob("*.json")):
        try:
            entries = read_json(list[tuple[int, str, float] | tuple[int, str]], read_text(file, MEBIBYTE), str(file))
        except DataError:
            continue
        found += [OpenCommandNote(file.stem, *entry) for entry in entries]
    return found


def set_aside(run_dir: Path) -> list[tuple[OpenCommandNote, Path]]:
    """Return the commands set aside unfinished, each with the folder of the remains."""
    folders = sorted((run_dir / MISSIONS).glob("*"))
    return [(command, folder) for folder in folders for command in noted(folder)]
