"""Figures of a running machine: its memory, and lines of a benchmark with a baseline of the same run and a bar."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Line:
    """One figure of a benchmark.

    Attributes:
        name: What was measured.
        value: The figure.
        unit: Its unit.
        baseline: The same quantity of something simple, measured in the same run; the ratio says more than the value.
        against: What the baseline is.
        bar: What the ratio (without baseline, the value) must not exceed, or must reach if ``at_least``; None: no bar.
        at_least: Whether the bar is a lower bound.
    """

    name: str
    value: float
    unit: str
    baseline: float | None = None
    against: str = ""
    bar: float | None = None
    at_least: bool = False

    @property
    def measure(self) -> float:
        """What the bar is for: the ratio to the baseline, or the value if there is none."""
        return self.value if self.baseline is None else self.value / self.baseline

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None if there is no bar."""
        if self.bar is None:
            return None
        return self.measure >= self.bar if self.at_least else self.measure <= self.bar

    def text(self) -> str:
        """The line for the terminal."""
        ratio = (
            "" if self.baseline is None else f"{self.measure:.4g} x {self.against} ({self.baseline:.4g} {self.unit})"
        )
        verdict = {None: "", True: "ok", False: "MISSED"}[self.met]
        sign = ">=" if self.at_least else "<="
        bar = "" if self.bar is None else f"{sign} {self.bar:g}"
        return f"{self.name:<34}{self.value:>10.4g} {self.unit:<5}{bar:>9} {verdict:<7}{ratio}".rstrip()


def table(lines: Sequence[Line]) -> str:
    """All lines, and how many bars were missed."""
    missed = sum(line.met is False for line in lines)
    closing = "all bars are met" if missed == 0 else f"{missed} bars are missed"
    return "\n".join([*(line.text() for line in lines), closing])


def memory_mib(pids: Iterable[int]) -> float:
    """Memory of processes, shared pages counted once in proportion (PSS) [MiB]; without those that ended."""
    total = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
        except OSError:
            continue
        total += next((int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")), 0)
    return total / 1024.0
