import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from im_bringup.tasks.agent import RESPAWN_LIMIT, Agent, Died, ProcessCommand, Started, commands
from im_bringup.tasks.deployment import Deployment
from im_core import clock
from im_core.config import parse_model
from im_core.processes.process import last_words

OBEDIENT = "import signal; print('up', flush=True); signal.sigwait({signal.SIGINT}); print('{name} ends', flush=True)"
LATE = """\
import signal, time
print("up", flush=True)
signal.sigwait({signal.SIGINT})
while time.process_time() < 0.5:
    pass
print("{name} ends", flush=True)
"""
STUBBORN = """\
import signal
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
print("up", flush=True)
while True:
    signal.pause()
"""


def python(tmp_path, name, code):
    code = code.replace("{name}", name)
    if "sigwait" in code:
        code = "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})\n" + code
    return ProcessCommand(name, (name,), [sys.executable, "-S", "-E", "-c", code], tmp_path / f"{name}.log")


def environment():
    return {"LD_LIBRARY_PATH": os.environ.get("LD_LIBRARY_PATH", "")}


def wait_for(condition, seconds=60.0):
    deadline = clock.monotonic() + seconds
    while not condition():
        assert clock.monotonic() < deadline
        clock.sleep(0.01)


def up(tmp_path, names):
    wait_for(
        lambda: all((tmp_path / f"{name}.log").exists() and last_words(tmp_path / f"{name}.log") for name in names)
    )


def test_shutdown_is_in_reverse_order(tmp_path):
    names = ["one", "two", "three"]
    agent = Agent([python(tmp_path, name, OBEDIENT) for name in names], environment())
    events = agent.start()
    assert [event.tasks for event in events] == [(name,) for name in names]
    up(tmp_path, names)
    assert agent.running() == names
    assert agent.shut_down() == []
    assert agent.running() == []
    ended = [(tmp_path / f"{name}.log").stat().st_mtime_ns for name in names]
    assert ended == sorted(ended, reverse=True)
    assert last_words(tmp_path / "two.log") == "two ends"


def test_who_does_not_listen_is_killed(tmp_path):
    agent = Agent([python(tmp_path, "deaf", STUBBORN), python(tmp_path, "good", OBEDIENT)], environment())
    agent.start()
    up(tmp_path, ["deaf", "good"])
    assert agent.shut_down() == ["deaf"]
    assert agent.running() == []


def test_who_waits_for_a_processor_is_not_killed(tmp_path):
    """It computes for half a second before it ends: beside eight others on one core that is late, but no hang."""
    core = max(os.sched_getaffinity(0))
    agent = Agent([python(tmp_path, "late", LATE)], environment())
    (started,) = agent.start()
    up(tmp_path, ["late"])
    os.sched_setaffinity(started.pid, {core})
    spin = [sys.executable, "-S", "-c", "while True: pass"]
    others = [subprocess.Popen(spin, start_new_session=True) for _ in range(8)]  # one scheduling group each, as it has
    try:
        for other in others:
            os.sched_setaffinity(other.pid, {core})
        assert agent.shut_down() == []
    finally:
        for other in others:
            other.kill()
            other.wait()
    assert last_words(tmp_path / "late.log") == "late ends"


class Crasher:
    """A process that has ended by itself."""

    pid = 5

    def poll(self):
        return 3

    def send_signal(self, number):
        raise AssertionError(f"signal {number} for a process that has ended")


def test_a_task_that_keeps_dying_is_given_up(tmp_path):
    agent = Agent([ProcessCommand("x", ("x",), ["x"], tmp_path / "x.log")], {}, lambda *_: Crasher())
    agent.respawn = True
    agent.start()
    events = [event for now in range(60) for event in agent.poll(now * 0.5)]
    starts = [event for event in events if isinstance(event, Started)]
    assert [event.restarts for event in starts] == list(range(1, RESPAWN_LIMIT + 1))
    assert isinstance(events[-1], Died)
    assert "given up" in events[-1].sentence
    assert agent.shut_down() == []


def test_without_respawn_the_dead_stay_dead(tmp_path):
    agent = Agent([ProcessCommand("x", ("x",), ["x"], tmp_path / "x.log")], {}, lambda *_: Crasher())
    agent.start()
    assert [event for now in range(10) for event in agent.poll(now)] == [
        Died(("x",), f"it ended with exit code 3 (log: {tmp_path / 'x.log'})")
    ]


class Failing:
    """A process that goes on, deaf to SIGTERM if told so."""

    pid = 5

    def __init__(self, deaf):
        self.deaf, self.code = deaf, None

    def poll(self):
        return self.code

    def send_signal(self, number):
        if number == signal.SIGKILL or not self.deaf:
            self.code = -number


@pytest.mark.parametrize("deaf", [False, True])
def test_a_task_that_says_it_cannot_go_on_is_ended_and_started_again(tmp_path, deaf):
    children = []

    def spawn(*_):
        children.append(Failing(deaf))
        return children[-1]

    agent = Agent([ProcessCommand("x", ("x",), ["x"], tmp_path / "x.log")], {}, spawn)
    agent.start()
    agent.replace("x", 5, "no physics", 0.0)
    assert children[0].code is None  # before the machine was ready the start fails instead
    agent.respawn = True
    agent.replace("x", 4, "a process that was replaced before", 0.0)
    agent.replace("y", 5, "a task of another host", 0.0)
    assert children[0].code is None
    agent.replace("x", 5, "no physics", 0.0)
    events = [event for now in range(20) for event in agent.poll(now * 0.5)]
    assert [type(event) for event in events] == [Died, Started]
    assert events[0].sentence.startswith("it failed: no physics (log: ")
    assert len(children) == 2
    assert children[1].code is None


def test_the_tasks_of_a_process_fail_die_and_start_together(tmp_path):
    children = []

    def spawn(*_):
        children.append(Failing(deaf=False))
        return children[-1]

    agent = Agent([ProcessCommand("both", ("x", "y"), ["x"], tmp_path / "both.log")], {}, spawn)
    assert [event.tasks for event in agent.start()] == [("x", "y")]
    assert agent.running() == ["x", "y"]
    agent.respawn = True
    agent.replace("y", 5, "no disk", 0.0)
    events = [event for now in range(20) for event in agent.poll(now * 0.5)]
    assert [(type(event), event.tasks) for event in events] == [(Died, ("x", "y")), (Started, ("x", "y"))]
    assert str(events[0]).startswith("tasks x, y: it failed: no disk (log: ")
    assert str(events[1]) == "tasks x, y started again, process 5"


def test_a_process_of_several_tasks_gets_the_parameters_of_each(tmp_path, monkeypatch):
    for package, executable in (("im_bringup", "shared_process"), ("lab", "oven"), ("lab", "scale")):
        program = tmp_path / "lib" / package / executable
        program.parent.mkdir(parents=True, exist_ok=True)
        program.touch(mode=0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    text = """
    hosts:
      localhost:
        kitchen:
          oven: {package: lab, executable: oven, node: /oven, parameters: {heat: 200.0}}
          scale: {package: lab, executable: scale, node: /scale, parameters: {use_sim_time: false}}
        bar:
          mixer: {package: lab, executable: scale, node: /mixer}
    """
    kitchen, bar = commands(parse_model(text, Deployment, name="d.yaml"), "localhost", tmp_path)
    assert (kitchen.name, kitchen.tasks, bar.tasks) == ("kitchen", ("oven", "scale"), ("mixer",))
    shared = str(tmp_path / "lib" / "im_bringup" / "shared_process")
    assert kitchen.argv[:3] == [shared, "lab/oven", "lab/scale"]
    assert bar.argv[:2] == [str(tmp_path / "lib" / "lab" / "scale"), "--ros-args"]
    assert bar.argv[-4:-2] == ["-r", "scale:__node:=mixer"]
    assert "-r" not in kitchen.argv
    assert kitchen.log == tmp_path / "log" / "kitchen.log"
    given = {"use_sim_time": True, "introspection": "contents"}
    assert yaml.safe_load(Path(kitchen.argv[-1]).read_text()) == {
        "/oven": {"ros__parameters": {**given, "heat": 200.0}},
        "/scale": {"ros__parameters": {**given, "use_sim_time": False}},
    }
    assert yaml.safe_load(Path(bar.argv[-1]).read_text()) == {"/mixer": {"ros__parameters": given}}


def test_the_last_words_are_those_of_the_process_that_died(tmp_path):
    log = tmp_path / "x.log"
    log.write_text("an older crash\n")
    agent = Agent([ProcessCommand("x", ("x",), ["x"], log)], {}, lambda *_: Crasher())
    agent.start()
    assert agent.poll(0.0) == [Died(("x",), f"it ended with exit code 3 (log: {log})")]


def test_children_end_when_the_agent_is_killed(tmp_path):
    code = (
        "import sys; from pathlib import Path; from im_bringup.tasks.agent import Agent, ProcessCommand\n"
        f"argv, log = [sys.executable, '-S', '-E', '-c', {OBEDIENT!r}], Path({str(tmp_path / 'x.log')!r})\n"
        "agent = Agent([ProcessCommand('x', ('x',), argv, log)], {})\n"
        "print(agent.start()[0].pid, flush=True); sys.stdin.read()"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    pid = int(parent.stdout.readline())
    os.kill(pid, 0)
    parent.send_signal(signal.SIGKILL)
    parent.wait()

    def gone():
        try:
            with open(f"/proc/{pid}/stat", encoding="ascii") as file:
                return file.read().split()[2] == "Z"
        except FileNotFoundError:
            return True

    wait_for(gone)
