"""The machine comes up in step, is known by name, mends what died, and goes down in order, leaving nothing."""

import json
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from rclpy.node import Node
from std_msgs.msg import UInt8

from im_bringup.machine import leftovers
from im_bringup.machine import machine_state as machine
from im_core.names import instance, run_dir
from im_core.processes.end_signals import END_SIGNALS
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_msgs.msg import TaskRegistry, TaskStatus
from im_msgs.srv import QueryTask
from support.whole_machine import ROOT


@pytest.fixture
def small_machine(script, small_deployment):
    """The small deployment, running."""
    done = script("start", small_deployment)
    assert done.returncode == 0, done.stderr
    yield done
    script("stop")


@pytest.fixture
def observer(ros):
    """A node that keeps what the bootstrap announces and what tasks report."""
    node = Node("observer")
    node.phases, node.registries, node.statuses = [], [], []
    node.create_subscription(UInt8, "/im/phase", lambda message: node.phases.append(message.data), qos.LATCHED)
    node.create_subscription(TaskRegistry, "/bootstrap/tasks", node.registries.append, qos.LATCHED)
    node.create_subscription(TaskStatus, "/im/task_status", node.statuses.append, qos.STATUS)
    return ros(node)


def tasks_when_ready(observer, wait_until):
    """The tasks, once the observer has heard that all are ready, which may be later than the start says so."""

    def ready():
        tasks = observer.registries[-1].tasks if observer.registries else []
        return tasks if tasks and all(task.phase == "ready" for task in tasks) else None

    return wait_until(ready, "all tasks to be ready")


def run_im(*arguments):
    """What ``im`` of this workspace does."""
    return subprocess.run([ROOT / "scripts" / "im", *arguments], capture_output=True, text=True, check=False)


def test_up_known_mended_down(small_machine, observer, wait_until, script):
    assert re.search(r"start: ready after \d+\.\d s: 2 tasks, ROS domain \d+, clock factor 1\n", small_machine.stdout)
    log = (run_dir() / "log" / "bootstrap.log").read_text()
    assert re.findall(r"phase (\w+)", log) == ["LOAD", "CONFIGURE", "START"]

    # Whoever comes later learns the phase and the registry.
    wait_until(lambda: observer.phases and observer.phases[-1] == 2, "the latched phase")
    tasks = {task.name: task for task in tasks_when_ready(observer, wait_until)}
    assert [(task.id, task.phase, task.node) for task in tasks.values()] == [
        (1, "ready", "/dom"),
        (2, "ready", "/gripper_coordinator"),
    ]

    # The same, and the load, for a person.
    told = run_im("tasks", "--json")
    shown = {task["name"]: task for task in json.loads(told.stdout)}
    assert {name: task["pid"] for name, task in shown.items()} == {name: task.pid for name, task in tasks.items()}
    assert all(task["process_memory_mib"] >= 0.0 and "callbacks_per_s" in task for task in shown.values())
    table = run_im("tasks").stdout.splitlines()
    assert [line.split()[:3] for line in table if line[0].isdigit()] == [
        ["1", "dom", "ready"],
        ["2", "gripper_coordinator", "ready"],
    ]
    for name in ("dom", "1", "/dom"):
        assert "package: im_dom\n" in run_im("tasks", name).stdout
    assert (run_im("tasks", "dm").returncode, run_im("tasks", "--timeout", "-1").returncode) == (1, 2)
    assert "there is no task 'dm'; did you mean 'dom'" in run_im("tasks", "dm").stderr

    # By symbolic name.
    query = observer.create_client(QueryTask, "/bootstrap/query_task")
    answer = call_blocking(query, QueryTask.Request(name="dom"), 60.0, "dom")
    assert answer.success
    assert (answer.task.host, answer.task.package, answer.task.executable) == ("localhost", "im_dom", "dom")
    assert answer.task.pid == tasks["dom"].pid
    assert answer.task.incarnation != 0
    unknown = call_blocking(query, QueryTask.Request(name="dm"), 60.0, "dm")
    assert (unknown.success, unknown.message) == (
        False,
        "there is no task 'dm'; did you mean 'dom'? (known: dom, gripper_coordinator)",
    )
    told = []
    events = "/bootstrap/query_task/_service_event"
    observer.create_subscription(QueryTask.Event, events, told.append, qos.SERVICE_EVENTS)
    wait_until(lambda: call_blocking(query, QueryTask.Request(name="dom"), 60.0, "dom") and told, "what a bag is told")

    # A task that is killed comes back, with another incarnation, and becomes ready alone.
    os.kill(answer.task.pid, signal.SIGKILL)

    def back():
        task = observer.registries[-1].tasks[0]
        return task if task.restarts == 1 and task.phase == "ready" else None

    task = wait_until(back, "dom to be ready again")
    assert task.incarnation != answer.task.incarnation
    assert any("was killed by SIGKILL" in registry.tasks[0].detail for registry in observer.registries)

    # A second start of the same ROS domain.
    second = script("start")
    assert second.returncode == 1
    assert f"a machine of ROS domain {machine.domain()} runs already (ready, process" in second.stderr

    # Down in order.
    down = script("stop")
    assert down.returncode == 0, down.stderr
    assert down.stdout.startswith("stop: all tasks ended in order")
    assert leftovers.processes() == []
    assert machine.read() is None


def test_tasks_of_one_process_die_and_come_back_together(small_deployment, script, observer, wait_until):
    """The gripper coordinator moves into the process of the DOM by one line of the file."""
    text = small_deployment.read_text()
    small_deployment.write_text(text.replace("    gripper_coordinator:\n", "", 1))
    done = script("start", small_deployment)
    assert done.returncode == 0, done.stderr
    try:
        killed = tasks_when_ready(observer, wait_until)
        assert [(task.name, task.process, task.phase) for task in killed] == [
            ("dom", "dom", "ready"),
            ("gripper_coordinator", "dom", "ready"),
        ]
        assert len({task.pid for task in killed}) == 1
        assert len({task.incarnation for task in killed}) == 2
        assert {"/dom", "/gripper_coordinator"} <= set(run_im("node", "list").stdout.split())
        put = run_im("dom", "put", "a", "std_msgs/msg/Empty", "{}").stdout
        assert put.startswith("a std_msgs/msg/Empty version "), put

        os.kill(killed[0].pid, signal.SIGKILL)

        def back():
            tasks = observer.registries[-1].tasks
            return tasks if all((task.restarts, task.phase) == (1, "ready") for task in tasks) else None

        tasks = wait_until(back, "both tasks to be ready again")
        assert len({task.pid for task in (*tasks, *killed)}) == 2
        assert len({task.incarnation for task in (*tasks, *killed)}) == 4
        assert run_im("dom", "list").stdout == put
        log = (run_dir() / "log" / "bootstrap.log").read_text()
        assert "tasks dom, gripper_coordinator: it was killed by SIGKILL" in log
    finally:
        down = script("stop")
    assert (down.returncode, leftovers.processes()) == (0, []), down.stderr


def test_after_kill_of_the_bootstrap_stop_leaves_nothing(small_machine, script):
    os.kill(machine.read().pid, signal.SIGKILL)
    done = script("stop")
    assert done.returncode == 0, done.stderr
    assert (leftovers.processes(), leftovers.of_others()) == ([], [])
    again = script("stop")
    assert (again.returncode, again.stdout) == (0, f"stop: no machine runs in ROS domain {machine.domain()}\n")


def test_a_bootstrap_that_is_killed_is_started_again_with_its_machine(small_machine, wait_until):
    killed = machine.read()
    os.kill(killed.pid, signal.SIGKILL)

    def another():
        record = machine.read()
        return record is not None and record.state == machine.READY and record.pid != killed.pid

    wait_until(another, "the machine to be ready again")


def test_a_start_after_a_killed_machine_works(small_machine, small_deployment, script):
    bootstrap = machine.read().pid
    supervisor = int(Path(f"/proc/{bootstrap}/stat").read_text().rpartition(")")[2].split()[1])
    for pid in (supervisor, bootstrap):
        os.kill(pid, signal.SIGKILL)
    done = script("start", small_deployment)
    assert done.returncode == 0, done.stderr


def test_what_cannot_start_is_named_and_nothing_is_left(script, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(
        """\
hosts:
  localhost:
    dom:
      dom: {package: im_dom, executable: dom, node: /dom}
    testbed:
      testbed: {package: im_sim, executable: testbed, node: /testbed, parameters: {factor: -1.0}}
"""
    )
    done = script("start", path)
    assert done.returncode == 1
    sentence = "testbed failed: factor -1.0 of /testbed is not between 0 and inf"
    assert f"start: not every task could be started:\n  {sentence}" in done.stderr
    assert leftovers.processes() == []
    assert machine.read() is None


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("executable: dom", "executable: dm"), "dom.dom: there is no executable of im_dom 'dm'; did you mean 'dom'?"),
        (("package: im_dom", "package: im_don"), "dom.dom: there is no package with executables 'im_don'; did you"),
        (("hosts", "host"), "small.yaml:2: host: Extra inputs are not permitted"),
        (("localhost", "elsewhere"), "hosts: there is no host of the deployment 'localhost' (known: elsewhere)"),
    ],
)
def test_wrong_deployments(script, small_deployment, change, sentence):
    small_deployment.write_text(small_deployment.read_text().replace(*change))
    done = script("start", small_deployment)
    assert (done.returncode, done.stdout, sentence in done.stderr) == (2, "", True), done.stderr
    assert done.stderr.startswith(f"start: {small_deployment}:")
    assert machine.read() is None


def test_a_task_on_another_host_takes_part(script, process, small_deployment, observer, wait_until):
    """The gripper coordinator moves to a host of its own by one line of the file."""
    text = small_deployment.read_text()
    small_deployment.write_text(text.replace("    gripper_coordinator:\n", "  far:\n    gripper_coordinator:\n", 1))
    agent = process(*run("im_bringup", "agent", "far", small_deployment))
    try:
        done = script("start", small_deployment)
        assert done.returncode == 0, done.stderr + agent.out.read_text()
        assert [(task.name, task.host, task.phase) for task in tasks_when_ready(observer, wait_until)] == [
            ("dom", "localhost", "ready"),
            ("gripper_coordinator", "far", "ready"),
        ]
    finally:
        script("stop")
    wait_until(lambda: agent.poll() is not None, "the end of the other host's agent")
    assert agent.returncode == 0, agent.out.read_text()


def run(*arguments):
    return ["bash", Path(__file__).resolve().parent.parent / "scripts" / "run.sh", *arguments]


@pytest.fixture
def endless_deployment(tmp_path):
    """A deployment that waits for a host that never comes."""
    path = tmp_path / "waits.yaml"
    path.write_text(
        """\
hosts:
  localhost:
    dom:
      dom: {package: im_dom, executable: dom, node: /dom}
  never:
    gripper_coordinator:
      gripper_coordinator: {package: im_coordinators, executable: gripper_coordinator, node: /gripper_coordinator}
"""
    )
    return path


@pytest.mark.parametrize("number", END_SIGNALS)
def test_a_signal_while_starting_leaves_nothing(process, wait_until, endless_deployment, number):
    child = process(*run("im_bringup", "start", endless_deployment))
    wait_until(lambda: machine.read(), "the bootstrap")
    os.kill(child.pid, number)
    wait_until(lambda: child.poll() is not None, "the end of start")
    assert child.returncode == 130, child.out.read_text()
    assert "interrupted" in child.out.read_text()
    assert leftovers.processes() == []
    assert machine.read() is None


@pytest.mark.parametrize("when", ["at once", "with a bootstrap"])
def test_stop_while_starting_ends_the_start_and_both_say_so(process, script, wait_until, endless_deployment, when):
    child = process(*run("im_bringup", "start", endless_deployment))
    wait_until(_is_starting if when == "at once" else machine.read, "the start")
    done = script("stop")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("stop: a start was under way, and has ended\n")
    wait_until(lambda: child.poll() is not None, "the end of start")
    assert (child.returncode, leftovers.processes(), machine.read()) == (1, [], None)
    assert child.out.read_text().endswith("start: the machine was stopped while it started\n")


def _is_starting():
    """Whether a start of this ROS domain holds its mark."""
    return any(line.endswith(f"@{instance()}_start") for line in Path("/proc/net/unix").read_text().splitlines())


def test_the_record_is_for_scripts(small_machine):
    data = json.loads(machine.record_path().read_text())
    assert {"pid", "state", "phase", "run_dir", "port", "seed", "clock_factor"} <= data.keys()
