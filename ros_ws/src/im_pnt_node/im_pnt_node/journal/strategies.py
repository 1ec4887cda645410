"""Experience with strategies in a file, kept from run to run."""

import fcntl
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from im_core.errors import StoreError
from im_core.files import FileError, write_whole
from im_core.text.jsontext import load_json
from im_pnt.errors import NetError
from im_pnt.execution.strategies import StrategyBook
from im_pnt.model.net import Strategy


class StrategyStore(StrategyBook):
    """Experience with strategies, in a file; several machines may learn in one, each adds its outcomes.

    Args:
        path: JSON file; read if it is there, and replaced at each outcome.

    Raises:
        NetError: The file is not one of these.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._unsaved: list[tuple[str, str, Strategy, bool]] = []
        if path.exists():
            self.learned = _load(path)

    def outcome(self, net: str, transition: str, strategy: Strategy, success: bool) -> None:
        """Count an outcome, and write the file with the counts of other machines: whole or not at all.

        Raises:
            OSError: It cannot be saved; the outcome is counted all the same, and saved with the next one.
            NetError: Likewise, for the file is not one of these any more.
        """
        super().outcome(net, transition, strategy, success)
        self._unsaved.append((net, transition, strategy, success))
        with _alone(self._path):
            if self._path.exists():
                self.learned = _load(self._path)
                for outcome in self._unsaved:
                    super().outcome(*outcome)
            content = {name: {"successes": s, "failures": f} for name, (s, f) in sorted(self.learned.items())}
            write_whole(self._path, json.dumps({"strategies": content}, indent=1) + "\n")
        self._unsaved.clear()


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


def _load(path: Path) -> dict[str, tuple[float, float]]:
    try:
        content = load_json(path)
    except FileError as error:
        raise NetError(f"{error.message}; strategies are needed", **error.facts) from error
    table = content.get("strategies") if isinstance(content, dict) else None
    if not isinstance(table, dict):
        raise NetError(f"{path}: there is no table 'strategies' in it", file=str(path))
    return {str(name): _counts(path, name, entry) for name, entry in table.items()}


def _counts(path: Path, name: str, entry: object) -> tuple[float, float]:
    if isinstance(entry, Mapping) and entry.keys() == {"successes", "failures"}:
        successes, failures = entry["successes"], entry["failures"]
        if all(type(count) in (int, float) and 0.0 <= count < math.inf for count in (successes, failures)):
            return float(successes), float(failures)
    raise NetError(
        f"{path}: strategy {name} is {str(entry)[:80]}; successes and failures >= 0 are needed", file=str(path)
    )
