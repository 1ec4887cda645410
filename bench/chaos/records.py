"""What came of injections: kept in a file of lines, over as many runs as it takes, and summed up in tables."""

import json
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path

from im_core.errors import DataError
from im_core.files import FileError, read_text, write_whole
from im_core.text.jsontext import JsonError, decode_json

#: A command should succeed again within this [s], in this share of the injections.
SOON_S, SHARE = 15.0, 0.95
BEGIN, END = "<!-- chaos: begin -->", "<!-- chaos: end -->"


class Verdict(Enum):
    """What an injection came to."""

    SUCCESS = "success"
    TRUE_REASON = "true reason"
    FALSE = "FALSE"
    HANG = "HANG"
    UNSAFE = "UNSAFE"
    LEFTOVER = "LEFTOVER"
    LOST = "NOT RECOVERED"

    @property
    def failure(self) -> bool:
        """Whether the bench fails with it."""
        return self not in (Verdict.SUCCESS, Verdict.TRUE_REASON)


@dataclass(frozen=True)
class Result:
    """What came of an injection.

    Attributes:
        seed: Repeats it.
        factor: Clock factor of the machine.
        kind: Kind of the fault.
        fault: What was done.
        verdict: What it came to.
        said: What the command said, and what else was found.
        recovery_s: From the end of fault and command to the next success, less the duration of a command [s].
    """

    seed: int
    factor: float
    kind: str
    fault: str
    verdict: Verdict
    said: str
    recovery_s: float | None


def append(file: Path, result: Result) -> None:
    """Add a line to a file.

    Raises:
        OSError: It cannot be written.
    """
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps({**asdict(result), "verdict": result.verdict.value}) + "\n")


def read(file: Path) -> list[Result]:
    """The results of a file of lines.

    Raises:
        FileError: It cannot be read, or a line is no result.
    """
    results = []
    for number, line in enumerate(read_text(file).splitlines(), 1):
        try:
            entry = decode_json(line)
            if not isinstance(entry, dict):
                raise DataError("it is no JSON object")
            results.append(Result(**{**entry, "verdict": Verdict(entry.get("verdict"))}))
        except (JsonError, DataError, TypeError, ValueError) as error:
            raise FileError(file, f"is no line of a chaos run: {error}", number) from error
    return results


def table(results: Sequence[Result]) -> str:
    """Faults against outcomes, and the times of recovery, for the terminal."""
    verdicts = _verdicts(results)
    lines = [f"{'fault':44}" + "".join(f"{verdict.value:>14}" for verdict in verdicts) + f"{'recovery [s]':>14}"]
    for row, mine in _rows(results, lambda result: result.fault):
        cells = "".join(f"{count or '':>14}" for count in _counts(mine, verdicts))
        lines.append(f"{row:44}{cells}{_slowest(mine):>14}")
    return "\n".join([*lines, summary(results)])


def markdown(results: Sequence[Result]) -> str:
    """Kinds against outcomes, for the documentation."""
    verdicts = _verdicts(results)
    heads = ["fault", "injections", *(verdict.value for verdict in verdicts), "slowest recovery [s]"]
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for row, mine in _rows(results, lambda result: result.kind):
        cells = [row, len(mine), *_counts(mine, verdicts), _slowest(mine)]
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return "\n".join([*lines, "", summary(results)])


def summary(results: Sequence[Result]) -> str:
    """How many, and how soon a command succeeded again, in a sentence."""
    if not results:
        return "no injections"
    times = sorted(result.recovery_s for result in results if result.recovery_s is not None)
    failures = sum(result.verdict.failure for result in results)
    factors = ", ".join(f"{count} at factor {factor:g}" for factor, count in _factors(results))
    told = f"{len(results)} injections ({factors}), {failures} failures"
    if not times:
        return f"{told}; no recovery"
    within = sum(seconds <= SOON_S for seconds in times) / len(results)
    middle = statistics.median(times)
    share = f"{within:.1%} within {SOON_S:g} s (bar {SHARE:.0%})"
    return f"{told}; recovery: median {middle:.1f} s, most {times[-1]:.1f} s, {share}"


def document(results: Sequence[Result], page: Path) -> None:
    """Write the table into a page of the documentation, between its marks.

    Raises:
        FileError: It cannot be read, or has no marks.
        StoreError: It cannot be written.
    """
    text = read_text(page)
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise FileError(page, f"has no '{BEGIN}' and '{END}'")
    write_whole(page, f"{before}{BEGIN}\n{markdown(results)}\n{END}{after}")


def _factors(results: Sequence[Result]) -> list[tuple[float, int]]:
    return sorted(Counter(result.factor for result in results).items())


def _verdicts(results: Sequence[Result]) -> list[Verdict]:
    return [verdict for verdict in Verdict if any(result.verdict is verdict for result in results)]


def _rows(results: Sequence[Result], name: Callable[[Result], str]) -> list[tuple[str, list[Result]]]:
    return [(row, [result for result in results if name(result) == row]) for row in sorted(set(map(name, results)))]


def _counts(results: Sequence[Result], verdicts: Sequence[Verdict]) -> list[int]:
    counts = Counter(result.verdict for result in results)
    return [counts[verdict] for verdict in verdicts]


def _slowest(results: Sequence[Result]) -> str:
    times = [result.recovery_s for result in results if result.recovery_s is not None]
    return f"{max(times):.1f}" if times else "-"
