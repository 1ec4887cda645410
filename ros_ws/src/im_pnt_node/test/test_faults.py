"""1,000 runs over a network that loses, doubles, swaps, delays and falls silent, between processes that die and return.

Tokens go from ``a`` over ``b`` and ``c`` into the sink of ``a``, and ``a`` asks ``b``, which asks ``c``. Whatever
happens: the tokens of all nets, in flight and in inboxes have the same sum at every instant, and in the end every one
is where it should be.
"""

import random

import pytest

from im_pnt.execution.events import TokenArrived
from im_pnt.execution.notification import Observer
from im_pnt.netfile import parse_net
from im_pnt_node.journal.folder import Files, Folder
from im_pnt_node.journal.state import link_state
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles

TOKENS, JOBS = 4, 3
NETS = {
    "a": f"""
net: na
places: {{source: {TOKENS}, sink: {{remote: true}}, jobs: {JOBS}, good: , bad: }}
transitions:
  leave: {{in: source, out: nb.p}}
  ask: {{in: jobs, out: good, request: nb.pass_on, on_failure: bad}}
""",
    "b": """
net: nb
places: {p: {remote: true}, wanted: , good: , bad: }
services: {pass_on: {entry: wanted, done: good, failed: bad}}
transitions:
  hand: {in: p, out: nc.p}
  pass: {in: wanted, out: good, request: nc.work, on_failure: bad}
""",
    "c": """
net: nc
places: {p: {remote: true}, q: , wanted: , good: , bad: }
services: {work: {entry: wanted, done: good, failed: bad}}
transitions:
  move: {in: p, out: q}
  back: {in: q, out: na.sink}
  work: {in: wanted, out: good}
""",
}
NODES = {"na": "a", "nb": "b", "nc": "c"}
PARSED = {name: parse_net(text) for name, text in NETS.items()}
STEP = 0.1


class Troubles(Observer):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def troubled(self, net: str, text: str) -> None:
        self.texts.append(text)


class World:
    """Three processes, a network and a clock, all from one seed."""

    def __init__(self, seed: int, files: dict[str, Files] | None = None) -> None:
        self.dice = random.Random(seed)
        self.now = 0.0
        self.loss = self.dice.choice((0.0, 0.1, 0.4))
        self.delay = self.dice.choice((0.05, 0.5, 2.0))
        self.compact_bytes = self.dice.choice((0, 3000, 10**9))
        self.silence = (0.0, 0.0)
        self.flying: list[tuple[float, str, str]] = []
        self.files: dict[str, Files] = files or {name: MemoryFiles(name) for name in NETS}
        self.dead: dict[str, float] = {}
        self.troubles = Troubles()
        self.alive: dict[str, JournalledProcess] = {}
        self.shadows: dict[str, JournalledProcess] = {}
        self.deaths = 0
        for name in NETS:
            self.alive[name] = self.process(name, self.files[name])

    def process(self, name: str, files: Files) -> JournalledProcess:
        return JournalledProcess(
            name,
            [PARSED[name]],
            files,
            nodes=NODES,
            transmit=self.transmit,
            clock=lambda: self.now,
            observer=self.troubles,
            compact_bytes=self.compact_bytes,
        )

    def transmit(self, node: str, packet: str) -> None:
        for _ in range(2 if self.dice.random() < 0.1 else 1):
            if self.dice.random() >= self.loss and not self.silence[0] <= self.now < self.silence[1]:
                self.flying.append((self.now + self.dice.random() * self.delay, node, packet))

    def kill(self, name: str) -> None:
        self.deaths += 1
        del self.alive[name]
        files = self.files[name]
        assert isinstance(files, MemoryFiles)
        self.files[name] = files.reborn()
        self.dead[name] = self.now + self.dice.choice((0.0, 0.3, 3.0, 15.0))

    def do(self, name: str, what) -> None:
        """Has a process do something; it may die of it, anywhere."""
        process = self.alive.get(name)
        if process is None:
            return
        try:
            what(process)
        except MemoryFiles.Death:
            self.kill(name)

    def step(self) -> None:
        self.now += STEP
        due = sorted(item for item in self.flying if item[0] <= self.now)
        self.flying = [item for item in self.flying if item[0] > self.now]
        for _, name, packet in due:
            self.do(name, lambda process, packet=packet: process.link.hear(packet))
            if self.dice.random() < 0.7:
                self.do(name, JournalledProcess.turn)
        for name in NETS:
            self.do(name, JournalledProcess.tick)
        for name, when in list(self.dead.items()):
            if self.now >= when:
                del self.dead[name]
                self.shadows.pop(name, None)
                try:
                    self.alive[name] = self.process(name, self.files[name])
                except MemoryFiles.Death:
                    self.alive[name] = None
                    self.kill(name)

    def trouble(self) -> None:
        """Something goes wrong, perhaps."""
        dice = self.dice.random()
        name = self.dice.choice("abc")
        if dice < 0.06 and name in self.alive:
            self.kill(name)
        elif dice < 0.12 and name in self.alive:
            files = self.files[name]
            assert isinstance(files, MemoryFiles)
            files.dies_after(self.dice.randrange(6), self.dice.random())
        elif dice < 0.14:
            self.silence = (self.now, self.now + 10.0)
        elif dice < 0.20:
            self.do(name, lambda process: process.journal.compact())

    def settled(self) -> bool:
        return not self.dead and not self.flying and all(self.rests(process) for process in self.alive.values())

    @staticmethod
    def rests(process: JournalledProcess) -> bool:
        return process.link.idle() and not any(executor.due for executor in process.exchange.nets.values())

    def tokens(self) -> int:
        """Tokens of the ring, wherever they are: of the dead, what their journals tell."""
        for name in self.dead:
            if name not in self.shadows:
                files = self.files[name]
                assert isinstance(files, MemoryFiles)
                self.shadows[name] = self.process(name, files.copy())
        processes = {**self.alive, **self.shadows}
        count = 0
        for name, process in processes.items():
            marking = process.exchange.nets[f"n{name}"].marking()
            count += sum(marking.get(place, 0) for place in ("source", "p", "q", "sink"))
            delivered = process.exchange.inboxes.deliveries.waiting().get(f"n{name}", [])
            count += sum(isinstance(event, TokenArrived) for event in delivered)
            count += sum(process.exchange.undeliverable.values())
            for node, peer in link_state(process.link)["peers"].items():
                there = link_state(processes[node].link)["peers"].get(name)
                floor = there["heard"][1] if there else 0
                count += sum(
                    entry[0] > floor and entry[2] is not None and entry[2][0] == "token" for entry in peer["waiting"]
                )
        return count

    def run(self, troubled_s: float = 8.0, most_s: float = 200.0) -> None:
        while self.now < troubled_s:
            self.trouble()
            self.step()
            if self.dice.random() < 0.3:
                assert self.tokens() == TOKENS
        self.loss = 0.0
        while not self.settled():
            self.step()
            assert self.now < most_s
        assert self.tokens() == TOKENS
        final = {name: process.exchange.nets[f"n{name}"].marking() for name, process in self.alive.items()}
        assert final == {"a": {"sink": TOKENS, "good": JOBS}, "b": {"SI": 1, "SO": 1}, "c": {"SI": 1, "SO": 1}}


@pytest.mark.parametrize("block", range(5))
def test_nothing_is_lost_or_doubled(block):
    deaths = 0
    for seed in range(100 * block, 100 * block + 100):
        world = World(seed)
        try:
            world.run()
        except Exception as error:
            raise AssertionError(f"seed {seed} at {world.now:.1f} s: {error!r}; {world.troubles.texts}") from error
        deaths += world.deaths
    assert deaths > 100


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_lost_or_doubled_on_real_files(seed, tmp_path):
    world = World(seed, {name: Folder(tmp_path / name) for name in NETS})
    for _ in range(60):
        if world.dice.random() < 0.2 and len(world.alive) > 1:
            name = world.dice.choice(sorted(world.alive))
            world.alive.pop(name).journal.close()
            path = max((tmp_path / name).glob("*.journal"))
            if world.dice.random() < 0.5:
                with path.open("ab") as file:
                    file.write(b'00000500 12345678 [["net"')
            world.dead[name] = world.now + 1.0
        world.step()
    world.loss = 0.0
    while not world.settled():
        world.step()
        assert world.now < 200.0
    assert world.tokens() == TOKENS
    assert world.alive["a"].exchange.nets["na"].marking() == {"sink": TOKENS, "good": JOBS}
