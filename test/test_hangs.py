"""A node that hangs is treated as dead by its agent: where it hung is in its log, and it is started again."""

import os
import signal
import sys
import threading
from itertools import pairwise

import pytest
from rclpy.parameter import Parameter

from im_bringup.tasks.agent import Agent, Died, ProcessCommand, Started
from im_core import clock
from im_core.ros.calls import run_in_thread
from im_core.ros.node import ManagedNode

NODE = '''\
"""A node that hangs in its first second, once."""
import os, pathlib, re, sys
from im_core.ros import run
from im_core.ros.node import ManagedNode

FOLDER, KIND = pathlib.Path(sys.argv.pop(1)), sys.argv.pop(1)

class Oven(ManagedNode):
    def __init__(self):
        super().__init__("oven")
        self.standstill_s = 1.0

    def phase_start(self):
        (FOLDER / "ready").write_text(str(os.getpid()))
        self.create_timer(1.2, self.bake, clock=self.steady_clock)

    def bake(self):
        if KIND == "none" or (FOLDER / "hung").exists():
            return
        (FOLDER / "hung").touch()
        self.hang_here()

    def hang_here(self):
        if KIND == "fifo":
            os.mkfifo(FOLDER / "fifo")
            open(FOLDER / "fifo").read()
        re.match("(a+)+$", "a" * 60 + "b")  # holds the interpreter for years

sys.exit(run.main(Oven))
'''


@pytest.fixture
def oven(tmp_path):
    agents = []

    def start(kind):
        (tmp_path / "oven.py").write_text(NODE, encoding="utf-8")
        argv = [sys.executable, "-u", str(tmp_path / "oven.py"), str(tmp_path), kind]
        command = ProcessCommand(
            "oven", ("oven",), [*argv, "--ros-args", "-p", "standalone:=true"], tmp_path / "oven.log"
        )
        agents.append(Agent([command], dict(os.environ)))
        agents[0].respawn = True
        agents[0].start()
        return agents[0]

    yield start
    for agent in agents:
        agent.shut_down()


def polled(agent, events):
    events += agent.poll(clock.monotonic())
    return events


@pytest.mark.parametrize(
    ("kind", "words"),
    [("fifo", "its loop stood still for "), ("interpreter", "its interpreter was held while it computed for ")],
)
def test_a_node_that_hangs_is_started_again(oven, tmp_path, wait_until, kind, words):
    agent, events = oven(kind), []
    wait_until(lambda: len(polled(agent, events)) >= 2, "the death and the new start")
    assert [type(event) for event in events] == [Died, Started]
    assert f"it failed: {words}" in events[0].sentence
    log = (tmp_path / "oven.log").read_text(encoding="utf-8")
    assert "in hang_here" in log
    first = (tmp_path / "ready").read_text()
    wait_until(lambda: polled(agent, events) and (tmp_path / "ready").read_text() != first, "the new one to be ready")
    assert len(events) == 2


def test_a_node_that_was_stopped_is_no_hang(oven, tmp_path, wait_until):
    agent, events = oven("none"), []
    pid = int(wait_until(lambda: (tmp_path / "ready").exists() and (tmp_path / "ready").read_text(), "the node"))
    os.kill(pid, signal.SIGSTOP)
    clock.sleep(3.0)  # three times what its loop may stand still
    os.kill(pid, signal.SIGCONT)
    began = clock.monotonic()
    while clock.monotonic() - began < 2.0:
        polled(agent, events)
        clock.sleep(0.02)
    assert events == []
    assert agent.running() == ["oven"]


def test_a_phase_that_ends_has_turned_before_less_is_allowed(ros, wait_until):
    """Else what stood still in it, however long, would count as a hang between its end and the next turn."""
    changes = []

    class Slow(ManagedNode):
        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            if name == "standstill_s":
                changes.append((value, self.turns))

    node = Slow("slow", parameter_overrides=[Parameter("standalone", value=True)])
    ros(node)
    wait_until(lambda: node.ready, "the node")
    lowered = [(before, after) for before, after in pairwise(changes) if after[0] < before[0]]
    assert len(lowered) == 2
    assert all(after[1] > before[1] for before, after in lowered)


def test_of_a_thread_that_takes_long_the_log_says_where_it_is(ros, capfd):
    """A Service that is not answered for a minute: does it compute, or wait for what does not come?"""
    node = ros(ManagedNode("oven", parameter_overrides=[Parameter("standalone", value=True)]))
    end, baked = threading.Event(), threading.Event()

    def bake_a_loaf():
        end.wait(60.0)

    async def bake():
        await run_in_thread(node, bake_a_loaf, tell_after_s=0.2)
        baked.set()

    node.spawn(bake())
    told, deadline = "", clock.monotonic() + 60.0
    while "in bake_a_loaf" not in told and clock.monotonic() < deadline:
        told += capfd.readouterr().err
        clock.sleep(0.05)
    end.set()
    assert "bake_a_loaf has not ended after 0.2 s" in told
    assert "in bake_a_loaf" in told
    assert baked.wait(60.0)
