"""The bytes of a journal stay what they were: a mission writes the lines of a sample, and comes back from each of them.

There is a sample for each version that was given out, in ``data/journal/<version>``. It has the entries in ``ENTRIES``,
and snapshots taken while actions run and requests wait; beside each file stands what came back from it. ``python
test_journal_format.py`` writes the sample of a new version; from then on the one before is read by what migrates it.
"""

import json
from pathlib import Path

import pytest

from im_core.errors import ImError
from im_pnt.execution.events import CommandCancelled, ModeSet, PauseSet, TokenArrived
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command, Request
from im_pnt.execution.operator import Mode
from im_pnt.netfile import parse_net
from im_pnt_node.distributed import link
from im_pnt_node.distributed.codec import COMMAND, REQUEST, encode_json
from im_pnt_node.journal import journal
from im_pnt_node.journal.log import VERSION
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles

SAMPLES = Path(__file__).parent / "data" / "journal"
SAMPLE = SAMPLES / str(VERSION)
MAIN = """
net: main
places: {idle: 1, ready: , planned: , near: , done: , bad: , spare: {remote: true}, many: {tokens: 2}}
transitions:
  begin: {in: idle, out: ready, symbol: go}
  drop: {in: idle, out: idle, symbol: drop}
  plan: {in: ready, out: planned, action: plan, on_failure: bad}
  ask: {in: planned, out: near, request: far.work, on_failure: bad}
  help: {in: near, out: done, request: local.work, on_failure: bad}
  finish: {in: done, out: idle, emit: go_done, guard: allowed}
  give_up: {in: bad, out: idle, emit: go_failed}
  tell: {in: spare, out: [far.p, far.p, far.nowhere]}
"""
LOCAL = """
net: local
places: {wanted: , good: , bad: }
services: {work: {entry: wanted, done: good, failed: bad}}
transitions: {dig: {in: wanted, out: good, action: dig, on_failure: bad}}
"""
FAR = """
net: far
places: {p: {remote: true}, q: , wanted: , waiting: , good: , bad: }
services: {work: {entry: wanted, done: good, failed: bad}}
transitions:
  move: {in: p, out: q}
  begin: {in: wanted, out: waiting}
  end: {in: waiting, out: good, guard: open}
  stop: {in: waiting, out: bad, guard: cancelled}
"""
NETS = {"a": [parse_net(MAIN), parse_net(LOCAL)], "b": [parse_net(FAR)]}
ENTRIES = {
    "net": {"command", "request", "token", "cancel", "request_cancelled", "ended", "mode", "pause", "fire", "phase",
            "end", "guard", "forgotten"},
    "exchange": {"posted", "asked", "answered", "closed", "undeliverable"},
    "link": {"out", "in", "acked", "refused", "void", "begin", "move", "epoch"},
}  # fmt: skip


class Mission:
    """Two processes that do all there is to be journalled; keeps the content of each file that was replaced."""

    def __init__(self) -> None:
        self.now = 0.0
        self.flying: list[tuple[str, str]] = []
        self.pages: dict[str, bytes] = {}
        self.open = self.allowed = self.dies = False
        self.files = {name: MemoryFiles(name) for name in NETS}
        self.alive: dict[str, JournalledProcess] = {}

    def start(self, name: str) -> JournalledProcess:
        self.keep(name)
        self.alive[name] = process = JournalledProcess(
            name,
            NETS[name],
            self.files[name],
            actions={"plan": self.plan, "dig": self.dig},
            guards={"open": lambda ctx: self.open, "allowed": self.may_finish},
            nodes={"far": "b", "main": "a"},
            transmit=lambda node, packet: self.flying.append((node, packet)),
            clock=lambda: self.now,
            return_timeout_s=30.0,  # as when the entries were written
        )
        return process

    def plan(self, ctx: ActionContext) -> None:
        ctx.memory["plans"] = [1, 2.5, None, "ü"]
        ctx.result["plan"] = {"x": True}
        ctx.progress("planned", 0.25)
        if self.dies:
            raise MemoryFiles.Death

    def dig(self, ctx: ActionContext) -> None:
        ctx.result["depth"] = 3

    def may_finish(self, ctx: ActionContext) -> bool:
        if not self.allowed:
            raise ImError("not yet", code="early", where=(1, "x"))
        return True

    def keep(self, name: str) -> None:
        for file, content in self.files[name].contents.items():
            self.pages[f"{name}-{len(self.pages):02d}-{file}"] = bytes(content)

    def compact(self, name: str) -> None:
        self.keep(name)
        self.alive[name].journal.compact()

    def restart(self, name: str) -> None:
        self.files[name] = self.files[name].reborn()
        self.start(name)

    def run(self, seconds: float = 1.0) -> None:
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            for process in self.alive.values():
                process.turn()
                process.tick()
            flying, self.flying = self.flying, []
            for node, packet in flying:
                if node in self.alive:
                    self.alive[node].link.hear(packet)

    def post(self, event: object) -> None:
        self.alive["a"].exchange.nets["main"].post(event)

    def command(self, number: int, symbol: str = "go", **arguments: object) -> None:
        self.alive["a"].exchange.nets["main"].command(Command(number, symbol, arguments))

    def fly(self, monkeypatch: pytest.MonkeyPatch) -> dict[str, bytes]:
        """Does everything; returns the files."""
        born_at(monkeypatch, 1_000_000_000)
        self.start("a")
        self.start("b")
        self.post(TokenArrived("spare", 2))
        self.run()
        self.command(1, speed=0.5, names=["x"])  # a request over the link, one in the process, and a guard that breaks
        self.run()
        self.compact("a")
        self.compact("b")
        self.open = True
        self.alive["b"].exchange.nets["far"].post(TokenArrived("p", 1))
        self.run()
        self.compact("a")
        self.allowed = True
        self.post(PauseSet(True))
        self.run(0.2)
        self.post(PauseSet(False))
        self.command(2, "drop")
        self.run()
        self.open = False
        self.command(3)  # a request that is cancelled
        self.command(4)
        self.run()
        self.post(CommandCancelled(3, ImError("enough", code="cancelled")))
        self.run()
        self.compact("b")
        self.compact("a")
        del self.alive["b"]  # it dies, is given up, and has lost its journal and its time when it comes back
        self.alive["a"].exchange.node_lost("b", "b is missing")
        self.post(TokenArrived("spare", 1))
        self.run(31.0)
        born_at(monkeypatch, 500_000_000)
        self.keep("b")
        self.files["b"] = MemoryFiles("b")
        self.start("b")
        self.run(3.0)
        self.post(ModeSet(Mode.STEP))
        self.post(ModeSet(Mode.AUTOMATIC))
        self.dies = True
        self.command(5)
        with pytest.raises(MemoryFiles.Death):
            self.run()
        self.dies = False
        self.restart("a")
        self.run()
        self.restart("a")
        self.post(CommandCancelled(None, ImError("all")))
        self.run(3.0)
        for name in NETS:
            self.keep(name)
        return self.pages


def born_at(monkeypatch: pytest.MonkeyPatch, epoch: int) -> None:
    """Has lives begin with epochs that a test can know."""
    for module in (journal, link):
        monkeypatch.setattr(module, "new_epoch", lambda after=0: max(epoch, after + 1))


def bodies(content: bytes) -> list[object]:
    return [json.loads(line[18:]) for line in content.splitlines()]


def sample() -> dict[str, bytes]:
    """The sample of the present version."""
    return {path.name: path.read_bytes() for path in sorted(SAMPLE.glob("*.journal"))}


def test_the_sample_has_every_entry():
    found: dict[str, set[str]] = {}
    for content in sample().values():
        for batch in bodies(content)[2:]:
            for entry in batch:
                found.setdefault(entry[0], set()).add(entry[-1][0])
    assert found == ENTRIES


def entries(content: bytes) -> list[str]:
    return sorted(encode_json(entry) for batch in bodies(content)[2:] for entry in batch)


def test_the_same_entries_are_written(monkeypatch):
    """Batches are cut otherwise than in the sample: two processes that meet exchange a packet more than they did."""
    pages = Mission().fly(monkeypatch)
    assert sorted(pages) == sorted(sample())
    for name, content in sample().items():
        assert pages[name].splitlines()[:2] == content.splitlines()[:2], name
        assert entries(pages[name]) == entries(content), name
        assert all(entry.encode() in pages[name] for entry in entries(content)), name


def brought_back(name: str, content: bytes) -> bytes:
    """What a process makes of a file: the file that it goes on with, before anything happens."""
    mission = Mission()
    process, _, file = name.split("-")
    mission.files[process].contents[file] = bytearray(content)
    mission.start(process)
    ((_, written),) = mission.files[process].contents.items()
    return bytes(written)


@pytest.mark.parametrize(
    "path", sorted(SAMPLES.glob("*/*.journal")), ids=lambda path: f"{path.parent.name}/{path.name}"
)
def test_what_any_version_has_written_is_brought_back_as_it_was(path):
    assert brought_back(path.name, path.read_bytes()) == path.with_suffix(".back").read_bytes()


def test_the_scope_of_a_command_is_written_with_it_and_with_its_requests():
    command = Command(7, "go", {"x": 1}, scope="dispatcher/20260131-142501-7")
    assert COMMAND.decode(COMMAND.content(command)) == command
    request = Request("r", "n", "s", "dispatcher", "m", "ask", command, {})
    assert REQUEST.decode(REQUEST.content(request)) == request


def write_sample(folder: Path) -> None:
    """Write the sample of the present version."""
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for name, content in Mission().fly(patch).items():
            (folder / name).write_bytes(content)
            (folder / name).with_suffix(".back").write_bytes(brought_back(name, content))


def test_the_sample_of_a_new_version_is_written_by_a_script(tmp_path):
    write_sample(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in SAMPLE.iterdir())


if __name__ == "__main__":
    write_sample(SAMPLE)
