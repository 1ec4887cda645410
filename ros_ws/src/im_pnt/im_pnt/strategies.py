"""Strategies: contending ways to do a thing, chosen by a probability of success that is learned (paper, section 2).

Each outcome of a transition with a strategy is counted in a Beta distribution whose counts decay, so that old outcomes
weigh less than new ones. Transitions that contend are taken with probabilities proportional to weight and mean success;
the entropy of that choice is the uncertainty of the decision in the sense of Saridis' entropy formulation [nats].
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from im_core.files import write_whole
from im_pnt.errors import NetError
from im_pnt.net import Strategy


class StrategyBook:
    """What was learned about strategies, by net and transition; kept in a file from run to run.

    Args:
        path: JSON file; read if it is there, and replaced at each outcome. None: kept in memory only.

    Raises:
        NetError: The file is not one of these.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._counts: dict[str, tuple[float, float]] = {}
        if path is not None and path.exists():
            self._counts = _load(path)

    def counts(self, net: str, transition: str, strategy: Strategy) -> tuple[float, float]:
        """Returns the successes and failures counted so far, those before the first run included."""
        return self._counts.get(f"{net}.{transition}", (strategy.successes, strategy.failures))

    def mean_success(self, net: str, transition: str, strategy: Strategy) -> float:
        """Returns the expected probability of success, 0.5 where nothing was counted."""
        successes, failures = self.counts(net, transition, strategy)
        return successes / (successes + failures) if successes + failures > 0.0 else 0.5

    def outcome(self, net: str, transition: str, strategy: Strategy, success: bool) -> None:
        """Counts an outcome, and saves the book.

        Raises:
            OSError: It cannot be saved; the outcome is counted all the same.
        """
        successes, failures = (count * strategy.decay for count in self.counts(net, transition, strategy))
        self._counts[f"{net}.{transition}"] = (successes + success, failures + (not success))
        if self._path is not None:
            self.save(self._path)

    def save(self, path: Path) -> None:
        """Writes the book; the file is replaced whole or not at all.

        Raises:
            OSError: It cannot be written.
        """
        content = {name: {"successes": s, "failures": f} for name, (s, f) in sorted(self._counts.items())}
        write_whole(path, json.dumps({"strategies": content}, indent=1) + "\n")


def probabilities(weights: Sequence[float]) -> list[float]:
    """Returns the probabilities of a choice, equal where all weights are 0.

    Args:
        weights: Relative frequencies, >= 0.
    """
    total = math.fsum(weights)
    return [weight / total for weight in weights] if total > 0.0 else [1.0 / len(weights)] * len(weights)


def entropy(distribution: Sequence[float]) -> float:
    """Returns the entropy of a distribution [nats]."""
    return -math.fsum(p * math.log(p) for p in distribution if p > 0.0) + 0.0


def _load(path: Path) -> dict[str, tuple[float, float]]:
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise NetError(f"{path}: strategies cannot be read: {error}", file=str(path)) from error
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
