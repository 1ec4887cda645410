"""A part of the benchmarks: what can be measured by name, and the beginning and ending of every ``bench.<part>``."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bench.figures import Line, Measured, measure, report, write
from im_bringup.machine.interrupts import interrupt_once
from im_core.errors import ImError

Work = Mapping[str, Callable[[], list[Line]]]

_EPILOG = (
    "Exit codes: 0 all bars that could be measured are met, 1 a bar is missed or a measurement failed, 2 bad usage, "
    "130 interrupted."
)


class Part:
    """What ``scripts/bench.sh --NAME`` is.

    Args:
        name: Its name.
        about: What it measures, and how.
        groups: What each group of figures is, by its name.
        usual: Groups that are measured where none is named; none: all.

    Attributes:
        parser: Of its command line; a part adds its own options.
    """

    def __init__(self, name: str, about: str, groups: Mapping[str, str], usual: Sequence[str] = ()) -> None:
        self._name, self._groups = name, groups
        self._usual = list(usual or groups)
        width = max(map(len, groups)) + 1
        told = [f"  {group:{width}} {what}{_mark(group, usual)}" for group, what in groups.items()]
        self.parser = argparse.ArgumentParser(
            prog=f"bench --{name}",
            description="\n".join([about, "", "groups:", *told]),
            epilog=_EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        which = "those marked *" if usual else "all"
        self.parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"only these ({which})")
        self.parser.add_argument(
            "--lines", type=Path, metavar="FILE", help="write the figures here only, as JSON, and show no table"
        )

    def run(self, work: Callable[[argparse.Namespace, Path], Work], arguments: Sequence[str] | None = None) -> int:
        """Reads the command line, measures, and shows and keeps the figures.

        Args:
            work: What measures each group, of the options and of a folder that is there meanwhile.
            arguments: Of the command line; None: the process' own.

        Returns:
            Exit code.
        """
        options = self.parser.parse_args(arguments)
        unknown = [group for group in options.groups if group not in self._groups]
        if unknown:
            self.parser.error(f"there is no group '{unknown[0]}'; there are {', '.join(self._groups)}")
        interrupt_once()
        with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
            try:
                ways = work(options, Path(folder))
            except ImError as error:
                print(f"bench: {error.message}", file=sys.stderr)
                return 2
            try:
                measured = measure(ways, options.groups or self._usual)
            except KeyboardInterrupt:
                print("bench: interrupted", file=sys.stderr)
                return 130
        return self._end(measured, options.lines)

    def _end(self, measured: Measured, file: Path | None) -> int:
        if file is not None:
            write(file, measured.lines)
        else:
            report(f"bench-{self._name}", measured.lines)
        return 0 if measured.good else 1


def positive(kind: type[int] | type[float]) -> Callable[[str], float]:
    """What reads an option that must be above 0."""

    def number(text: str) -> float:
        value = kind(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} must be above 0")
        return value

    return number


def _mark(group: str, usual: Sequence[str]) -> str:
    return " *" if group in usual else ""
