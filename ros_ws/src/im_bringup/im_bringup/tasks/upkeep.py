"""Care for the disk of a host: rotation of logs, and removal of surplus and outdated results."""

import re
import shutil
import threading
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Annotated

from pydantic import Field

from im_core import clock
from im_core.config import Model

LOOK_S = 10.0
PRUNE_EVERY = 360
TOOL_LOGS = 100
_DAY_S = 86_400.0
#: What is read of a log at once of what comes while it is rotated, and how often: a writer may be as fast as this.
_PIECE_BYTES = 2**20
_MOST_PIECES = 100

_RESULT = re.compile(r"(\d{8}-\d{6})(?:-(\d+))?")
_CALIBRATION = re.compile(r"(?:.*-)?(\d{8}-\d{6})(?:-(\d+))?")
_EVIDENCE = re.compile(r"(?:\d{8}-\d{6}_)?\d{9,}_\w+\.(?:npz|csv)")
_REMOVED = re.compile(r"\..+\.removed")


class Keep(Model):
    """Limits for the kept files of a machine.

    Attributes:
        results: How many results of commands, calibrations of ``/vss`` and files of evidence; the newest stay.
        days: How long they are kept [days].
        log_mib: Size from which a log is moved to ``<task>.log.1``, in the place of the one before [MiB].
    """

    results: Annotated[int, Field(ge=1)] = 1000
    days: Annotated[float, Field(gt=0.0)] = 365.0
    log_mib: Annotated[float, Field(gt=0.0, le=1024.0)] = 16.0

    def sentence(self, results: Path) -> str:
        """Return the sentence on the limits, printed at start."""
        age, size = f"{self.days:g} days", f"{self.log_mib:g} MiB"
        return f"of {results} the newest {self.results} are kept, for {age}; logs are rotated at {size}"


def rotate(log: Path, most_bytes: float) -> bool:
    """Move the content of an overlong log to ``<log>.1``; a writer of the log goes on at the beginning of the log.

    What comes meanwhile is moved, too, up to the end that was seen last. What is written between that look and the cut
    is lost, since no lock keeps writers away: mostly nothing, and up to some milliseconds of a process that writes as
    fast as it can.

    Args:
        log: The log; its writers append (O_APPEND).
        most_bytes: Longest log [bytes].

    Returns:
        Whether it was too long.

    Raises:
        OSError: There is no room for the copy; the log is as it was, and so is the one before, unless it was what came
            meanwhile that had no room.
    """
    if log.stat().st_size <= most_bytes:
        return False
    copy = log.with_name(f"{log.name}.1.new")
    try:
        with log.open("r+b", buffering=0) as source, copy.open("wb") as target:
            shutil.copyfileobj(source, target)
            target.flush()  # no room for the last of it is known now
            copy.replace(log.with_name(f"{log.name}.1"))
            for _ in range(_MOST_PIECES):
                if not (piece := source.read(_PIECE_BYTES)):
                    break
                target.write(piece)
                target.flush()
            source.truncate(0)
    except OSError:
        copy.unlink(missing_ok=True)
        raise
    return True


def surplus(found: Iterable[tuple[Path, float]], keep: Keep, now: float) -> list[Path]:
    """Return the surplus and outdated paths for removal; never the newest of all.

    Args:
        found: Each with the time it is from [s since 1970].
        keep: What is kept.
        now: The time [s since 1970].
    """
    ordered = sorted(found, key=lambda entry: (entry[1], entry[0].name), reverse=True)
    old = [path for path, time in ordered[1 : keep.results] if now - time > keep.days * _DAY_S]
    return old + [path for path, _ in ordered[max(1, keep.results) :]]


def prune(results: Path, keep: Keep, spared: Collection[Path], now: float) -> list[Path]:
    """Remove surplus and outdated results of the machine; nothing else in the folder is touched.

    Args:
        results: Folder of the results.
        keep: What is kept.
        spared: Folders that are in use, whatever their age.
        now: The time [s since 1970].

    Returns:
        What was removed.
    """
    using = {path.resolve() for path in (*spared, results / "latest")}
    kinds = (_commands(results), _calibrations(results / "vss"), _evidence(results / "mcs"))
    unwanted = [path for found in kinds for path in surplus(found, keep, now) if path.resolve() not in using]
    removed = [path for path in unwanted if _remove(path)]
    for folder in (results, results / "vss"):
        for path in _entries(folder):
            if _REMOVED.fullmatch(path.name):  # of one that was interrupted
                shutil.rmtree(path, ignore_errors=True)
    return removed


def prune_tool_logs(folder: Path, most: int = TOOL_LOGS) -> list[Path]:
    """Remove all but the newest ROS logs, written one per process ever started."""
    logs = sorted((path for path in _entries(folder) if path.suffix == ".log"), key=_time, reverse=True)
    for path in logs[most:]:
        path.unlink(missing_ok=True)
    return logs[most:]


class Upkeep:
    """Care for the files of one host, in a separate thread.

    Args:
        run_dir: Folder of the machine's logs.
        results: Folder of its results.
        keep: What is kept.
        spared: Folders of results that are in use.
        say: Writes a warning to the log.
    """

    def __init__(
        self, run_dir: Path, results: Path, keep: Keep, spared: Collection[Path], say: Callable[[str], None]
    ) -> None:
        self._run_dir, self._results, self._keep, self._spared, self._say = run_dir, results, keep, spared, say
        self._end = threading.Event()
        self._said: set[str] = set()
        self._thread = threading.Thread(target=self._run, name="upkeep", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, when the present look is over."""
        self._end.set()

    def rotate_logs(self) -> None:
        """Look at all logs once."""
        for folder in (self._run_dir, self._run_dir / "log", self._run_dir / "ros"):
            for log in _entries(folder):
                if log.suffix == ".log":
                    self._try(lambda log=log: rotate(log, self._keep.log_mib * 2**20))  # type: ignore[misc]

    def _run(self) -> None:
        looks = 0
        while not self._end.wait(LOOK_S):
            self._try(self.rotate_logs)
            looks += 1
            if looks % PRUNE_EVERY == 0:
                self._try(lambda: prune(self._results, self._keep, self._spared, clock.wall()))
                self._try(lambda: prune_tool_logs(self._run_dir / "ros"))

    def _try(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            if str(error) not in self._said:  # a disk that stays full is said once
                self._said.add(str(error))
                self._say(f"upkeep: {error}")


def _commands(results: Path) -> list[tuple[Path, float]]:
    """Return the folders of commands: named by a time, with a report or, of a killed command, without any content."""
    named = [path for path in _entries(results) if _RESULT.fullmatch(path.name) and _is_folder(path)]
    return [(path, _time(path)) for path in named if (path / "report.json").is_file() or not _entries(path)]


def _calibrations(folder: Path) -> list[tuple[Path, float]]:
    """Return the results of ``/vss``: folders with files only."""
    return [
        (path, _time(path))
        for path in _entries(folder)
        if _CALIBRATION.fullmatch(path.name) and _is_folder(path) and all(entry.is_file() for entry in _entries(path))
    ]


def _evidence(folder: Path) -> list[tuple[Path, float]]:
    return [(path, _time(path)) for path in _entries(folder) if _EVIDENCE.fullmatch(path.name) and path.is_file()]


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _time(path: Path) -> float:
    try:
        return path.lstat().st_mtime
    except OSError:  # another machine removed it meanwhile
        return 0.0


def _remove(path: Path) -> bool:
    """Remove a file or folder; a folder is renamed first, so no reader finds half of the folder."""
    try:
        if not _is_folder(path):
            path.unlink()
            return True
        path = path.rename(path.with_name(f".{path.name}.removed"))
    except OSError:
        return False
    shutil.rmtree(path, ignore_errors=True)
    return True
