"""Stores on a disk of which each call fails in turn; in a process in which ``failing_disk.c`` was loaded before libc.

``python -m support.failing_disk STORE FOLDER``: carries the story of a store out once for each call that it makes of
the disk, with that call failing (EIO), and once more with the disk failing from that call on. Then the story of a store
is carried out with each allocation of memory failing in turn. A failure may be told, or end the process; whatever was
acknowledged must be there afterwards, whole. Prints how many stories were told; ends with 1 at the first that is wrong.
"""

import ctypes
import errno
import json
import os
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from im_core.errors import ImError
from im_pnt.errors import DamagedJournalError

Say = Callable[[object], None]
_ALLOCATIONS = 200
"""Of a story so many fail, spread over all of them."""


def attempt(
    say: Say, what: object, work: Callable[[], object], told: type[Exception] | tuple[type[Exception], ...] = ImError
) -> bool:
    """Say that something is tried, and that it is done; return whether it is. A failure is told by certain errors."""
    say(["tried", what])
    try:
        work()
    except told:
        return False
    say(["done", what])
    return True


class Dom:
    """Data objects."""

    STEPS = (("a", "one"), ("b", "two"), ("a", "three"), ("a", "four"), ("b", "five"))

    @staticmethod
    def opened(folder: Path) -> Any:
        """Return the store, or None where it is refused."""
        from im_dom.store import ObjectStore

        try:
            return ObjectStore(folder / "dom.sqlite")
        except ImError:
            return None

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        if (store := Dom.opened(folder)) is None:
            return
        for name, data in Dom.STEPS:
            attempt(
                say, [name, data], lambda name=name, data=data: store.put(name, "t/msg/T", data.encode(), "", "", 0)
            )
        try:
            store.close()
        except ImError:
            return

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        from im_dom.store import ObjectStore

        store = ObjectStore(folder / "dom.sqlite")
        assert not store.aside, store.aside
        assert not store.damages()
        found = {record.name: store.get(record.name)[1].decode() for record in store.records()}
        store.close()
        for name in ("a", "b"):
            tried = [data for how, (of, data) in said if how == "tried" and of == name]
            done = [data for how, (of, data) in said if how == "done" and of == name]
            newest = tried[tried.index(done[-1]) :] if done else [None, *tried]
            assert found.get(name) in newest, f"{name}: {found.get(name)} instead of one of {newest}"


class Reopened(Dom):
    """Data objects that are there already: what a disk that fails once has refused is no damage."""

    @staticmethod
    def prepare(folder: Path) -> None:
        Dom.tell(folder, lambda _: None)

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        if (store := Dom.opened(folder)) is None:
            return
        assert not store.aside, store.aside
        attempt(say, ["a", "six"], lambda: store.put("a", "t/msg/T", b"six", "", "", 0))

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        Dom.check(folder, [[how, list(step)] for step in Dom.STEPS for how in ("tried", "done")] + said)


class Journal:
    """The journal of a node."""

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        from im_pnt_node.journal.folder import Folder
        from im_pnt_node.journal.log import Log, Sync

        try:
            files = Folder(folder / "journal")
            files.lock()
            log = Log(files, Sync.DISK)
            log.recover()
        except ImError:
            return
        if not attempt(say, ["begin"], lambda: log.replace({"node": "test"}, {"state": 0})):
            return
        for number in range(3):
            attempt(say, [number], lambda number=number: log.append(f"[{number}]"))
        attempt(say, ["snapshot"], lambda: log.replace({"node": "test"}, {"state": 1}))
        for number in range(3, 6):
            attempt(say, [number], lambda number=number: log.append(f"[{number}]"))
        log.close()

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        from im_pnt_node.journal.folder import Folder
        from im_pnt_node.journal.log import look

        recovered = look(Folder(folder / "journal"))
        done = [what for how, (what,) in said if how == "done"]
        tried = [what for how, (what,) in said if how == "tried"]
        if recovered is None:
            assert not done
            return
        batches = [number for _, (number,) in recovered.batches]
        assert recovered.state in ({"state": 0}, {"state": 1})
        assert recovered.state == {"state": 1} or "snapshot" not in done
        first = 3 if recovered.state == {"state": 1} else 0
        assert set(batches) <= set(tried), batches
        lost = [number for number in done if isinstance(number, int) and number >= first and number not in batches]
        assert not lost, f"{lost} of {done} lost; {batches} are there"
        assert batches == sorted(batches)


class JournalReopened(Journal):
    """A journal that is there already: what cannot be read once is neither damaged nor begun anew."""

    @staticmethod
    def prepare(folder: Path) -> None:
        Journal.tell(folder, lambda _: None)

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        from im_pnt_node.journal.folder import Folder
        from im_pnt_node.journal.log import Log, Sync

        try:
            files = Folder(folder / "journal")
            files.lock()
            log = Log(files, Sync.DISK)
            recovered = log.recover()
        except DamagedJournalError:
            raise
        except ImError:
            return
        assert recovered is not None
        assert [batch for _, batch in recovered.batches] == [[3], [4], [5]]
        for number in (6, 7):
            attempt(say, [number], lambda number=number: log.append(f"[{number}]"))
        log.close()

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        before = [[0], [1], [2], ["snapshot"], [3], [4], [5]]
        Journal.check(folder, [[how, what] for what in before for how in ("tried", "done")] + said)


class Strategies:
    """Experience with strategies that is there already."""

    @staticmethod
    def outcome(name: str) -> Any:
        from im_pnt.execution.strategies import DONE, StrategyOutcome
        from im_pnt.model.net import Strategy

        return StrategyOutcome(name, Strategy(decay=1.0), DONE, ())

    @staticmethod
    def prepare(folder: Path) -> None:
        from im_pnt_node.journal.strategies import StrategyStore

        StrategyStore(folder / "strategies.json", print).outcome(Strategies.outcome("n.t"))

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        from im_pnt_node.journal.strategies import StrategyStore

        def refuse(text: str) -> None:
            raise AssertionError(text)

        try:
            store = StrategyStore(folder / "strategies.json", refuse)
        except ImError:
            return
        for _ in range(3):
            attempt(say, 1, lambda: store.outcome(Strategies.outcome("n.t")), (ImError, OSError))

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        from im_pnt_node.journal.strategies import read_experience

        assert not list(folder.glob("*damaged*"))
        done = [how for how, _ in said].count("done")  # one of which the disk failed at the very end may count twice
        successes = read_experience(folder / "strategies.json")["n.t"].successes
        assert successes >= 1 + done, f"{successes} after {said}"


class Calibration:
    """Camera files changed together: all of one calibration are in force."""

    @staticmethod
    def change(folder: Path, version: int) -> None:
        from im_cell.calibration_files import change_camera_files

        change_camera_files(folder, dict.fromkeys(("left.yaml", "right.yaml"), str(version)))

    @staticmethod
    def prepare(folder: Path) -> None:
        Calibration.change(folder, 0)

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        for version in (1, 2, 3):
            attempt(say, version, lambda version=version: Calibration.change(folder, version), (ImError, OSError))

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        from im_cell.calibration_files import camera_files

        in_force = {path.name: int(path.read_text()) for path in camera_files(folder)}
        assert set(in_force) == {"left.yaml", "right.yaml"}, in_force
        assert len(set(in_force.values())) == 1, in_force
        tried = [version for how, version in said if how == "tried"]
        newest = max([version for how, version in said if how == "done"], default=0)
        assert in_force["left.yaml"] in {newest, *(version for version in tried if version > newest)}, in_force


class Bag:
    """A recording."""

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        from im_bag import BagWriter, Delivery, PartLimits

        try:
            writer = BagWriter(folder / "bag", PartLimits(size_bytes=250, free_bytes=0))
            writer.add_topic("/a", "std_msgs/msg/String", Delivery(reliable=True, latched=False, depth=1))
        except ImError:
            return
        for number in range(6):
            data = str(number).zfill(100).encode()
            try:
                writer.write("/a", number, data)
            except ImError:
                break
            attempt(say, number, writer.flush)
        try:
            writer.close()
        except ImError:
            return

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        from im_bag import BagReader

        done = [number for how, number in said if how == "done"]
        if not done:
            return
        with BagReader(folder / "bag") as reader:
            found = [int(data) for _, _, data in reader.messages(["/a"])]
        assert found == sorted(set(found)), found
        assert set(done) <= set(found), f"{sorted(set(done) - set(found))} lost; {found} are there"


class Results:
    """The report of a command, and what points to the latest."""

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        from im_dispatcher.report import make_directory, write_report

        for number in (1, 2):
            try:
                made = make_directory(folder, f"20260101-00000{number}")
            except ImError:
                continue
            attempt(say, number, lambda made=made, number=number: write_report(made, {"number": number}))

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        done = [number for how, number in said if how == "done"]
        reports = [json.loads(path.read_text())["number"] for path in folder.glob("*/report.json")]
        assert set(done) <= set(reports), f"{done} told, {reports} there"
        if done:
            latest = json.loads((folder / "latest" / "report.json").read_text())["number"]
            assert latest >= done[-1], f"the latest is {latest}, told was {done[-1]}"


class Ended:
    """How commands have ended: kept in memory on a disk that fails, so that only what a disk that works took counts."""

    @staticmethod
    def tell(folder: Path, say: Say) -> None:
        from im_pnt_node.journal.ended import EndedCommand, EndedCommands

        ended = EndedCommands()
        try:
            ended.keep_in(folder / "ended", sync=True)
        except ImError:
            return
        for number in (1, 2, 3):
            command = EndedCommand(
                number=number, symbol="home", time=4e9, success=True, code="", message="", facts={}, results={}
            )
            attempt(say, number, lambda command=command: ended.add(command))
        assert ended.newest(3) == [1, 2, 3]

    @staticmethod
    def check(folder: Path, said: list[list[object]]) -> None:
        from im_pnt_node.journal.ended import EndedCommands

        ended = EndedCommands()
        ended.keep_in(folder / "ended", sync=True)
        assert set(ended.newest(3)) <= {number for how, number in said if how == "tried"}


_STORES = (Dom, Reopened, Journal, JournalReopened, Strategies, Calibration, Bag, Results, Ended)
STORES = {kind.__name__.lower(): kind for kind in _STORES}


def in_child(
    arm: Callable[[], None], tell: Callable[[Path, Say], None], folder: Path
) -> tuple[list[list[object]], tuple[int, int]]:
    """Carry a story out in a child process; return what it has said, and how many calls and allocations it made."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 0
        try:
            os.close(reading)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            arm()
            tell(folder, lambda what: os.write(writing, json.dumps(what).encode() + b"\n") and None)
        except MemoryError:
            code = 0
        except BaseException:
            disk().failing_memory_arm(0)
            os.write(writing, json.dumps(["broken", traceback.format_exc()]).encode() + b"\n")
            code = 1
        made = disk().failing_memory_count()
        disk().failing_memory_arm(0)
        os.write(writing, json.dumps(["calls", [disk().failing_disk_count(), made]]).encode() + b"\n")
        os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        said = [json.loads(line) for line in pipe.read().splitlines() if line.endswith(b"]")]
    os.waitpid(child, 0)
    counts = next((counts for how, counts in said if how == "calls"), (0, 0))
    return [each for each in said if each[0] != "calls"], counts


def disk() -> ctypes.CDLL:
    """Return the library that was loaded before libc."""
    return ctypes.CDLL(None)


def stories(kind: type, folder: Path) -> Iterator[str]:
    """Carry all stories of a store out, and check each; yields what was done in each."""

    def story(name: str, arm: Callable[[], None], may_be_told: bool) -> tuple[int, int]:
        place = folder / "place"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(prepared, place)
        said, counts = in_child(arm, kind.tell, place)
        broken = [why for how, why in said if how == "broken"]
        assert may_be_told or not broken, f"{kind.__name__}, {name}: {broken[0]}"
        try:
            kind.check(place, [each for each in said if each[0] != "broken"])
        except Exception as error:
            raise AssertionError(f"{kind.__name__}, {name}, after {said}: {error}") from error
        return counts

    prepared, warm = folder / "prepared", folder / "warm"
    prepared.mkdir()
    getattr(kind, "prepare", lambda _: None)(prepared)
    shutil.copytree(prepared, warm)
    kind.tell(warm, lambda _: None)  # what it loads and makes once is there in each child
    place = str(folder / "place").encode()

    def arm_nothing() -> None:
        disk().failing_disk_arm(place, ctypes.c_long(0), 0, 0)
        disk().failing_memory_arm(ctypes.c_long(0))

    calls, allocations = story("nothing fails", arm_nothing, False)
    assert calls > 5, f"only {calls} calls of the disk were seen"
    for nth in range(1, calls + 1):
        for onwards in (0, 1):
            name = f"call {nth} of {calls} fails{' and all that follow' if onwards else ''}"
            arm = lambda nth=nth, on=onwards: disk().failing_disk_arm(place, ctypes.c_long(nth), errno.EIO, on)  # noqa: E731
            story(name, arm, False)
            yield name
    for nth in range(1, allocations + 1, 1 + allocations // _ALLOCATIONS):
        name = f"allocation {nth} of {allocations} fails"
        story(name, lambda nth=nth: disk().failing_memory_arm(ctypes.c_long(nth)), True)
        yield name


if __name__ == "__main__":
    print(sum(1 for _ in stories(STORES[sys.argv[1]], Path(sys.argv[2]))))
