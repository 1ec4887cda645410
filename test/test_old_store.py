"""A consistent old copy of the object store is put back: a node that has seen what it lacks says so."""

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from std_msgs.msg import String

from im_core.ros import qos
from im_core.ros.calls import pause
from im_core.ros.run import spin_in_thread
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

NET = """
net: keeper
places: {idle: 1}
templates:
  command:
    parameters: [does]
    places: {"$(does)_done": , "$(does)_bad": }
    transitions:
      "$(does)": {symbol: $(does), in: idle, out: $(does)_done, action: $(does), on_failure: $(does)_bad}
      end_$(does): {in: $(does)_done, out: idle, emit: $(does)_done}
      fail_$(does): {in: $(does)_bad, out: idle, emit: $(does)_failed}
use: [{template: command, with: {does: keep}}, {template: command, with: {does: read}}]
"""
OLD = "the object store of /dom is an old copy: its last transaction is 1, 2 was acknowledged before"
OTHER = "the object store of /dom is not the one that it was: what was put into that one is lost"
PARTS = "dom.sqlite*"


class Keeper(PntNode):
    """Keeps objects and reads them, with a journal; hears what is said on ``/diagnostics``."""

    def __init__(self, folder: Path) -> None:
        self.goes_on, self.said, self.ended = False, set(), {}
        (folder / "keeper.yaml").write_text(NET)
        super().__init__(
            "keeper",
            [folder / "keeper.yaml"],
            {"keep": self.keep, "read": self.read},
            verifier=verify_to_load,
            parameter_overrides=[
                Parameter("standalone", value=True), Parameter("journal_dir", value=str(folder / "journal"))
            ],
        )  # fmt: skip
        self.create_subscription(DiagnosticArray, "/diagnostics", self._hear, qos.STATUS)

    def _hear(self, array: DiagnosticArray) -> None:
        self.said |= {each.message for each in array.status if each.name == "keeper: objects"}

    async def keep(self, ctx) -> None:
        await self.dom.put(ctx.command.arguments["name"], String(data="kept"))

    async def read(self, ctx) -> None:
        while not self.goes_on:
            await pause(self, 0.02)
        await self.dom.get(ctx.command.arguments["name"], String)

    def begin(self, symbol: str, name: str) -> None:
        async def work() -> None:
            self.ended[symbol, name] = await self.commands.run(symbol, {"name": name})

        self.spawn(work())


class Store:
    """``/dom`` in a process that is killed, and the files of its store."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.copy = folder, folder / "copy"
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "im_dom.ros.node", "--ros-args", "-p", "standalone:=true"]
        self._process = subprocess.Popen(command, env={**os.environ, "IM_RUN_DIR": str(self.folder)})

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def back_up(self) -> None:
        self.copy.mkdir()
        for part in self.folder.glob(PARTS):
            shutil.copy(part, self.copy)

    def put_back(self) -> None:
        """Puts the copy into the place of the store, or nothing where none was made."""
        for part in self.folder.glob(PARTS):
            part.unlink()
        for part in self.copy.glob("*"):
            shutil.copy(part, self.folder)


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    rclpy.init()
    store = Store(tmp_path)
    yield store
    store.kill()
    rclpy.try_shutdown()


@contextmanager
def kept(store, wait_until):
    """A node that has kept two objects; between them the store was copied, unless it was not."""
    node = Keeper(store.folder)
    with spin_in_thread(node):
        wait_until(lambda: node.begun, "the node to begin")
        for name in ("first", "second"):
            in_loop(node, partial(node.begin, "keep", name))
            wait_until(lambda: ("keep", name) in node.ended, f"{name} to be kept")  # noqa: B023
            assert node.ended["keep", name].success, node.ended["keep", name]
            if name == "first":
                store.kill()
                store.back_up()
                store.start()
        yield node


@pytest.mark.parametrize(
    ("others", "heard"),
    [(False, True), (False, False), (True, True)],
    ids=["old copy", "old copy, no former heartbeat", "another store"],
)
def test_a_command_that_fails_for_an_old_store_says_so(store, wait_until, others, heard):
    with kept(store, wait_until) as node:
        in_loop(node, partial(node.begin, "read", "second"))
        if others:
            shutil.rmtree(store.copy)
        store.kill()
        if not heard:  # an incarnation that dies early has often given none, yet its services have answered
            in_loop(node, lambda: node.heartbeats._last.pop("dom", None))
        store.put_back()
        store.start()
        said = wait_until(lambda: node.said, "what is said of the store")
        assert [text.startswith(OTHER if others else OLD) for text in said] == [True]
        node.goes_on = True
        outcome = wait_until(lambda: node.ended.get(("read", "second")), "the command")
        assert not outcome.success
        assert "second" in outcome.status.message
        before = outcome.status.message.partition("before that: ")[2].split("; ")
        assert [text for text in before if text.startswith(OTHER if others else OLD)], outcome.status.message


@pytest.mark.parametrize("old", [False, True])
def test_a_node_remembers_the_store_in_its_journal(store, wait_until, old):
    """A store that is as it was is no reason to say anything."""
    with kept(store, wait_until):
        pass
    store.kill()
    if old:
        store.put_back()
    store.start()
    node = Keeper(store.folder)
    with spin_in_thread(node):
        wait_until(lambda: node.begun, "the node to begin")
        if old:
            said = wait_until(lambda: node.said, "what is said of the store")
            assert [text.startswith(OLD) for text in said] == [True]
        in_loop(node, partial(node.begin, "keep", "third"))
        assert wait_until(lambda: node.ended.get(("keep", "third")), "the command").success
        assert node.dom.seen.mark.number == (2 if old else 3)
        assert bool(node.said) == old
