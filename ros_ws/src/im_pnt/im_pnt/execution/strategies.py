"""Experience with strategies: alternatives chosen by a learned probability of success (paper, section 2).

Each outcome of a transition with a strategy is counted in a Beta distribution whose counts decay, so that old outcomes
weigh less than new ones.
"""

import fcntl
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from im_core.errors import StoreError
from im_core.files import FileError, write_whole
from im_core.jsontext import load_json
from im_pnt.errors import NetError
from im_pnt.model.net import Strategy


class StrategyBook:
    """Experience with strategies, by net and transition; kept in a file from run to run.

    Several machines may learn in one file: each adds its outcomes to what is there.

    Args:
        path: JSON file; read if it is there, and replaced at each outcome. None: kept in memory only.

    Raises:
        NetError: The file is not one of these.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._counts: dict[str, tuple[float, float]] = {}
        self._unsaved: list[tuple[str, Strategy, bool]] = []
        if path is not None and path.exists():
            self._counts = _load(path)

    def counts(self, net: str, transition: str, strategy: Strategy) -> tuple[float, float]:
        """Return the successes and failures counted so far, including counts from before the first run."""
        return self._counts.get(f"{net}.{transition}", (strategy.successes, strategy.failures))

    def mean_success(self, net: str, transition: str, strategy: Strategy) -> float:
        """Return the expected probability of success, 0.5 without any count."""
        successes, failures = self.counts(net, transition, strategy)
        return successes / (successes + failures) if successes + failures > 0.0 else 0.5

    def outcome(self, net: str, transition: str, strategy: Strategy, success: bool) -> None:
        """Count an outcome, and save the book.

        Raises:
            OSError: It cannot be saved; the outcome is counted all the same, and saved with the next one.
            NetError: Likewise, for the file is not one of these any more.
        """
        name = f"{net}.{transition}"
        self._count(name, strategy, success)
        if self._path is not None:
            self._unsaved.append((name, strategy, success))
            self._save(self._path)

    def _count(self, name: str, strategy: Strategy, success: bool) -> None:
        before = self._counts.get(name, (strategy.successes, strategy.failures))
        successes, failures = (count * strategy.decay for count in before)
        self._counts[name] = (successes + success, failures + (not success))

    def _save(self, path: Path) -> None:
        """Write the book, with the counts of other machines; the file is replaced whole or not at all."""
        with _alone(path):
            if path.exists():
                self._counts = _load(path)
                for outcome in self._unsaved:
                    self._count(*outcome)
            content = {name: {"successes": s, "failures": f} for name, (s, f) in sorted(self._counts.items())}
            write_whole(path, json.dumps({"strategies": content}, indent=1) + "\n")
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
