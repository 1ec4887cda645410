"""kill -9 at every single point of a mission: the effects are those of a run that nobody killed, or it says otherwise.

The mission has two nets with a request between them, a guard, strategies, a failure arc, and actions whose effects are
lines in a file. A child process executes it and kills itself at point k: before, in the middle of and after each write
of the journal, each synchronisation and renaming of its files, and before and after each effect. Other children go on.
"""

import json
import os
import random
import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from im_core.errors import DataError
from im_pnt.execution.functions import ActionContext, GuardFunction
from im_pnt.execution.jobs import Command
from im_pnt.execution.notification import Firing, Observer, Phase
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net
from im_pnt_node.journal.folder import Folder
from support.journalled import JournalledProcess

BOSS = parse_net(
    """
net: boss
places: {idle: 1, a: , b: , c: , d: , e: , f: , g: , h: , oops: }
transitions:
  begin: {in: idle, out: a, symbol: go}
  first: {in: a, out: b, action: first, on_failure: oops}
  ask: {in: b, out: c, request: worker.work, on_failure: oops}
  right: {in: c, out: d, guard: answered}
  wrong: {in: c, out: oops, guard: not answered}
  north: {in: d, out: e, action: north, on_failure: oops, strategy: {}}
  south: {in: d, out: e, action: south, on_failure: oops, strategy: {successes: 2}}
  break: {in: e, out: f, action: breaks, on_failure: g}
  mend: {in: g, out: f, action: mend, on_failure: oops}
  again: {in: f, out: h, request: worker.work, on_failure: oops}
  finish: {in: h, out: idle, emit: go_done}
  fail: {in: oops, out: idle, emit: go_failed}
"""
)
WORKER = parse_net(
    """
net: worker
places: {wanted: , half: , good: , bad: }
services: {work: {entry: wanted, done: good, failed: bad}}
transitions:
  begin: {in: wanted, out: half, action: dig, on_failure: bad}
  end: {in: half, out: good, action: fill, on_failure: bad}
"""
)
ERRAND = parse_net(
    """
net: errand
places: {idle: 1, wanted: , there: , oops: }
interrupts:
  person: {during: reach, if: in_the_way, do: [{action: say}, {action: wait}], then: restart}
transitions:
  begin: {in: idle, out: wanted, symbol: go}
  reach: {in: wanted, out: there, request: legs.walk, on_failure: oops}
  finish: {in: there, out: idle, emit: go_done}
  fail: {in: oops, out: idle, emit: go_failed}
"""
)
LEGS = parse_net(
    """
net: legs
places: {wanted: , walking: , good: , bad: }
services: {walk: {entry: wanted, done: good, failed: bad}}
transitions:
  start: {in: wanted, out: walking, action: start, on_failure: bad}
  brake: {in: walking, guard: cancelled, out: bad, action: brake, on_failure: bad}
  arrive: {in: walking, guard: clear, out: good, action: arrive, on_failure: bad}
"""
)


class Mission(NamedTuple):
    """Two nets, the first with the command ``go``; its actions, and its guards, by the effects so far."""

    nets: tuple[Net, Net]
    actions: tuple[str, ...]
    guards: Callable[[Callable[[], list[str]]], Mapping[str, GuardFunction]]


SERVED = Mission(
    (BOSS, WORKER),
    ("first", "north", "south", "breaks", "mend", "dig", "fill"),
    lambda effects: {"answered": lambda ctx: ctx.replies["ask"] == {"last": "fill"}},
)
INTERRUPTED = Mission(
    (ERRAND, LEGS),
    ("start", "brake", "say", "wait", "arrive"),
    lambda effects: {
        "in_the_way": lambda ctx: "start" in effects() and "say" not in effects(),
        "clear": lambda ctx: "say" in effects(),
    },
)


class Killer:
    """Counts the points of a run and kills the process at one of them."""

    def __init__(self, point: int | None) -> None:
        self.left = point
        self.count = 0

    def point(self) -> None:
        self.count += 1
        if self.left is not None and self.count > self.left:
            os.kill(os.getpid(), signal.SIGKILL)


class KillingFolder(Folder):
    """A folder in whose files the process may die."""

    def __init__(self, path: Path, killer: Killer) -> None:
        super().__init__(path)
        self.killer = killer

    def create(self, name):
        self.killer.point()
        return KillingFile(super().create(name), self.killer)

    def extend(self, name, size):
        self.killer.point()
        return KillingFile(super().extend(name, size), self.killer)

    def rename(self, name, new):
        self.killer.point()
        super().rename(name, new)
        self.killer.point()

    def remove(self, name):
        super().remove(name)
        self.killer.point()


class KillingFile:
    def __init__(self, file, killer: Killer) -> None:
        self.file, self.killer = file, killer
        self.sync, self.close = file.sync, file.close

    def write(self, data: bytes) -> None:
        self.killer.point()
        self.killer.count += 1
        if self.killer.left is not None and self.killer.count > self.killer.left:
            self.file.write(data[: len(data) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        self.file.write(data)
        self.killer.point()


class Teller(Observer):
    """Writes down which actions came in doubt."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fired(self, firings: Sequence[Firing]) -> None:
        for firing in firings:
            if firing.phase is Phase.DOUBT:
                append(self.path, f"{firing.net}.{firing.transition}")


def append(path: Path, line: str) -> None:
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(file, f"{line}\n".encode())
    os.close(file)


def lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def live(folder: Path, point: int | None, compact_bytes: int, mission: Mission) -> None:
    """One life of the process: the mission, from where it is to its end."""
    killer = Killer(point)

    def effect(name: str) -> Callable[[ActionContext], None]:
        def act(ctx: ActionContext) -> None:
            killer.point()
            append(folder / "effects", name)
            ctx.memory.setdefault("done", []).append(name)
            ctx.result["last"] = name
            killer.point()
            if name == "breaks":
                raise DataError("it breaks")

        return act

    process = JournalledProcess(
        "machine",
        mission.nets,
        KillingFolder(folder / "journal", killer),
        actions={name: effect(name) for name in mission.actions},
        guards=mission.guards(lambda: lines(folder / "effects")),
        observer=Teller(folder / "doubts"),
        compact_bytes=compact_bytes,
    )
    boss = process.exchange.nets[mission.nets[0].name]
    process.turn()
    results = []
    if boss.sequence == 0:
        boss.command(Command(1, "go"), results.append)
    for _ in range(20):
        boss.guards_changed()
        process.turn()
        killer.point()
    assert not boss.busy()
    marking = {name: executor.marking() for name, executor in process.exchange.nets.items()}
    process.journal.close()
    (folder / "end").write_text(json.dumps({"marking": marking, "points": killer.count}))


def run(folder: Path, points: list[int], compact_bytes: int, mission: Mission = SERVED) -> dict:
    """Runs the mission in lives that end at given points, and then to its end."""
    folder.mkdir(parents=True)
    for point in [*points, None]:
        child = os.fork()
        if child == 0:
            try:
                live(folder, point, compact_bytes, mission)
                os._exit(0)
            except BaseException as error:
                append(folder / "errors", repr(error))
            finally:
                os._exit(1)
        _, status = os.waitpid(child, 0)
        assert os.WIFSIGNALED(status) or os.waitstatus_to_exitcode(status) == 0, lines(folder / "errors")
        if not os.WIFSIGNALED(status):
            break
    return {
        **json.loads((folder / "end").read_text()),
        "effects": lines(folder / "effects"),
        "doubts": lines(folder / "doubts"),
    }


def check(killed: dict, whole: dict, points: list[int]) -> None:
    """Either everything is as without interruption, or an action was reported in doubt and nothing was done twice."""
    assert killed["marking"] == whole["marking"], points
    if killed["doubts"]:
        expected = list(whole["effects"])
        for effect in killed["effects"]:
            assert effect in (*expected, "north", "south", "mend"), points
            if effect in expected:
                expected.remove(effect)
        assert len(killed["doubts"]) <= len(points)
        for effect in ("first", "north", "south", "breaks", "mend"):
            assert killed["effects"].count(effect) <= 1, (points, effect)
    else:
        assert killed["effects"] == whole["effects"], points


@pytest.mark.parametrize("compact_bytes", [10**9, 0], ids=["one file", "compacting all the time"])
def test_killed_at_every_single_point(tmp_path, compact_bytes):
    whole = run(tmp_path / "whole", [], compact_bytes)
    assert [e for e in whole["effects"] if e not in ("north", "south")] == [
        "first", "dig", "fill", "breaks", "mend", "dig", "fill",
    ]  # fmt: skip
    assert whole["doubts"] == []
    assert whole["marking"]["boss"] == {"idle": 1}
    clean = 0
    for point in range(whole["points"]):
        killed = run(tmp_path / str(point), [point], compact_bytes)
        check(killed, whole, [point])
        clean += not killed["doubts"]
    assert clean > whole["points"] // 3


def test_killed_again_and_again(tmp_path):
    whole = run(tmp_path / "whole", [], 2000)
    dice = random.Random(0)
    for trial in range(20):
        points = [dice.randrange(whole["points"]) for _ in range(dice.randrange(2, 6))]
        check(run(tmp_path / str(trial), points, 2000), whole, points)


def test_an_interrupt_that_is_killed_at_any_point_happens_once(tmp_path):
    """Before the cancel, while the action ends, in what is done, and before the action begins again."""
    whole = run(tmp_path / "whole", [], 10**9, INTERRUPTED)
    assert whole["effects"] == ["start", "brake", "say", "wait", "start", "arrive"]
    assert whole["doubts"] == []
    assert whole["marking"] == {"errand": {"idle": 1}, "legs": whole["marking"]["legs"]}
    clean = 0
    for point in range(whole["points"]):
        killed = run(tmp_path / str(point), [point], 10**9, INTERRUPTED)
        assert killed["marking"] == whole["marking"], point
        assert len(killed["doubts"]) <= 1, point
        if killed["doubts"]:  # what is in doubt has failed, and is not done again
            left = iter(whole["effects"])
            assert all(effect in left for effect in killed["effects"]), point
        else:
            assert killed["effects"] == whole["effects"], point
            clean += 1
    assert clean > whole["points"] // 3
