"""Experience with strategies in a file, kept from run to run."""

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from im_core import clock
from im_core.config import Model
from im_core.errors import StoreError
from im_core.files import FileError, move, write_whole
from im_core.text.jsontext import load_json
from im_pnt.errors import NetError
from im_pnt.execution.strategies import Experience, StrategyBook, StrategyOutcome

_Count = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]


class ExperienceEntry(Model):
    """Entry of the file: experience with a strategy in a context."""

    successes: _Count
    failures: _Count
    prior: tuple[_Count, _Count] = (1.0, 1.0)
    last: str = Field("", max_length=200)


class StrategyStore(StrategyBook):
    """Experience with strategies, in a file; several machines may learn in one, each adds its outcomes.

    Args:
        path: JSON file; read if it is there, and replaced at each outcome. A damaged one is moved aside.
        tell: Is told why a file was moved aside, and to where.

    Raises:
        FileError: The system does not read the file.
        StoreError: A damaged file cannot be moved aside.
    """

    def __init__(self, path: Path, tell: Callable[[str], None]) -> None:
        super().__init__()
        self._path, self._tell = path, tell
        self._unsaved: list[StrategyOutcome] = []
        self._read()

    def outcome(self, outcome: StrategyOutcome) -> None:
        """Count an outcome, and write the file with the counts of other machines: whole or not at all.

        Raises:
            OSError: It cannot be saved; the outcome is counted all the same, and saved with the next one.
            FileError: Likewise, for the file of before cannot be read.
            StoreError: Likewise, for another machine writes it, or a damaged file cannot be moved aside.
        """
        super().outcome(outcome)
        self._unsaved.append(outcome)
        with _alone(self._path):
            if self._read():
                for each in self._unsaved:
                    super().outcome(each)
            self._write()
        self._unsaved.clear()

    def forget(self, start: str) -> list[str]:
        """Forget a strategy in all contexts or in one, here and in the file; return the forgotten names.

        Raises:
            OSError: The file cannot be written.
            FileError: The system does not read it.
            StoreError: It cannot be written, either.
        """
        with _alone(self._path):
            self._read()
            gone = super().forget(start)
            self._write()
        return gone

    def _read(self) -> bool:
        """Read the file if there is one; move a damaged file aside, and keep the experience of this process.

        Returns:
            Whether the file was read.

        Raises:
            FileError: The system does not read it: nothing says that it is damaged.
        """
        try:
            self.learned = read_experience(self._path)
        except FileError as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise
            return False
        except NetError as error:
            moment_ms = round(1000 * clock.wall())
            while (aside := self._path.with_name(f"{self._path.name}.damaged-{moment_ms}")).exists():
                moment_ms += 1
            move(self._path, aside)
            self._tell(f"{error.message}; it is moved to {aside.name}, and its strategies are learned anew")
            return False
        return True

    def _write(self) -> None:
        content = {name: asdict(each) for name, each in sorted(self.learned.items())}
        write_whole(self._path, json.dumps({"strategies": content}, indent=1) + "\n")


def read_experience(path: Path) -> dict[str, Experience]:
    """Return the experience in a file, by strategy.

    Raises:
        FileError: The system does not read the file: its content may be whole.
        NetError: The file is not one of these; says which, where and what is allowed.
    """
    try:
        content = load_json(path)
    except FileError as error:
        if isinstance(error.__cause__, OSError):
            raise
        raise NetError(f"{error.message}; strategies are needed", **error.facts) from error
    table = content.get("strategies") if isinstance(content, dict) else None
    if not isinstance(table, dict):
        raise NetError(f"{path}: there is no table 'strategies' in it", file=str(path))
    learned = {}
    for name, entry in table.items():
        try:
            learned[str(name)] = Experience(**ExperienceEntry.model_validate(entry).model_dump())
        except ValidationError as error:
            told = error.errors()[0]
            key = ".".join(map(str, told["loc"]))
            needed = "successes and failures >= 0 are needed"
            text = f"{path}: strategy {name} is {str(entry)[:80]}: {key}: {told['msg']}; {needed}"
            raise NetError(text, file=str(path)) from error
    return learned


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Keep other machines from changing a file meanwhile.

    Raises:
        StoreError: One of them does.
    """
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)  # given back with the folder
        yield
    except BlockingIOError as error:
        reason = "another machine writes it; the next outcome brings this one along"
        raise StoreError(f"{path}: {reason}", file=str(path), reason=reason) from error
    finally:
        os.close(folder)
