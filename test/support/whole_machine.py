"""The whole machine, run by the scripts at clock factor 0, and a node that talks to it."""

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import threading
from pathlib import Path

import yaml

from im_core import clock
from im_core.config import package_file

ROOT = Path(__file__).resolve().parent.parent.parent
SEED = 3
FEW = 12
"""Poses of :func:`write_few_poses`; with three less the cameras are still calibrated."""
COMMAND_S = 600.0
EACH = package_file("im_bringup", "deployments/each.yaml")
"""The deployment in which every task has a process of its own."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def write_few_poses(folder: Path, count: int = FEW) -> Path:
    """A file of some of the cell's own poses at equal distances, not listed in their shortest order."""
    own = yaml.safe_load(package_file("im_cell", "cells/puma_pair/ceiling_40.yaml").read_text())
    some = own["poses"][:: len(own["poses"]) // (count - 1)][:count]
    own["poses"] = [pose for first in range(4) for pose in some[first::4]]
    assert len(own["poses"]) == count
    path = folder / "few.yaml"
    path.write_text(yaml.safe_dump(own))
    return path


def run_script(name, *arguments, timeout=300.0, **environment):
    """Runs ``scripts/<name>.sh``, or ``scripts/im``, to its end."""
    return subprocess.run(
        ["bash", str(ROOT / "scripts" / (name if name == "im" else f"{name}.sh")), *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        env={**os.environ, **environment},
        cwd=ROOT,
        check=False,
    )


@contextlib.contextmanager
def running_machine(*arguments, port=0):
    """A machine that is ready, of the default deployment or another; it is stopped at the end of the block.

    Args:
        arguments: Of ``scripts/start.sh``: a deployment, options.
        port: Of the page; 0: a free one.
    """
    started = run_script("start", *arguments, "--factor", 0, "--seed", SEED, "--port", port or free_port())
    assert started.returncode == 0, started.stdout + started.stderr
    machine = Machine()
    try:
        yield machine
    finally:
        machine.close()
        ended = run_script("stop")
    assert ended.returncode == 0, ended.stdout + ended.stderr


class Machine:
    """A running machine and a node that talks to it."""

    def __init__(self):
        import rclpy

        from im_core.ros import qos
        from im_core.ros.guard import GuardedActionClient
        from im_core.ros.node import ManagedNode
        from im_core.ros.run import spin_in_thread
        from im_msgs.action import ExecuteCommand
        from im_msgs.msg import Firing, TaskRegistry

        rclpy.init(args=[])
        self.node = ManagedNode("case_study_test")
        self.firings = []
        self.tasks = {}
        self._clients = {}
        self.node.create_subscription(Firing, "/pnt/firings", self.firings.append, qos.EVENTS)
        self.node.create_subscription(TaskRegistry, "/bootstrap/tasks", self._registry, qos.LATCHED)
        self._execute = GuardedActionClient(self.node, ExecuteCommand, "/dispatcher/execute")
        self.spinner = spin_in_thread(self.node)

    def _registry(self, message):
        self.tasks = {task.name: task for task in message.tasks}

    def call(self, kind, name, /, timeout=60.0, **fields):
        from im_core.ros.calls import call_blocking

        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            assert self._clients[name].wait_for_service(60.0), f"nobody offers {name}"
            clock.sleep(0.5)  # the server must have discovered the client, too, or its answer is lost; nothing tells
        return call_blocking(self._clients[name], kind.Request(**fields), timeout, f"{name} of the test")

    def calibrate(self, poses="", cameras=()):
        from im_msgs.srv import CalibrateCamera

        return self.call(
            CalibrateCamera,
            "/dispatcher/calibrate_camera",
            COMMAND_S,
            cameras=list(cameras),
            poses_file=str(poses),
        )

    def execute(self, symbol, **arguments):
        """Gives a command; a function that waits for its end, with ``told``: what is told of it until then."""
        from im_msgs.action import ExecuteCommand

        self.wait_for(self._execute.server_is_ready, "the dispatcher")
        goal, told = ExecuteCommand.Goal(symbol=symbol, arguments=json.dumps(arguments)), []
        sent = self._execute.send_goal_async(goal, feedback_callback=lambda message: told.append(message.feedback))
        self.wait_for(sent.done, f"{symbol} to be taken")
        ended = sent.result().get_result_async()

        def result(seconds=COMMAND_S):
            self.wait_for(ended.done, f"{symbol} to end", seconds)
            return ended.result().result

        result.told = told
        return result

    def stand(self, name, place, turn=0.0):
        """Puts a free body somewhere, upright, turned about the vertical."""
        from geometry_msgs.msg import Point, Pose, Quaternion

        from im_msgs.srv import PlaceObject

        turned = Quaternion(z=math.sin(turn / 2), w=math.cos(turn / 2))
        pose = Pose(position=Point(**dict(zip("xyz", place, strict=True))), orientation=turned)
        placed = self.call(PlaceObject, "/testbed/place_object", name=name, pose=pose)
        assert placed.success, placed.message

    def trigger(self, name):
        from std_srvs.srv import Trigger

        return self.call(Trigger, name)

    def in_background(self, poses):
        answers = []
        thread = threading.Thread(target=lambda: answers.append(self.calibrate(poses)), daemon=True)
        thread.start()
        return thread, answers

    def wait_for(self, condition, what, seconds=60.0):
        deadline = clock.monotonic() + seconds
        while not condition():
            assert clock.monotonic() < deadline, f"waited {seconds} s for {what}, in vain"
            clock.sleep(0.02)

    def all_ready(self):
        self.wait_for(lambda: self.tasks and all(t.phase == "ready" for t in self.tasks.values()), "all tasks")

    def kill(self, victim):
        """Kills a task; returns what waits until the one that takes its place is ready."""
        before = self.tasks[victim].incarnation
        os.kill(self.tasks[victim].pid, signal.SIGKILL)
        return lambda: self.wait_for(
            lambda: self.tasks[victim].incarnation != before and self.tasks[victim].phase == "ready",
            f"{victim} to come back",
        )

    def wait_for_firing(self, net, transition, count=1):
        begin = len(self.firings)

        def seen():
            fired = [f for f in self.firings[begin:] if (f.net, f.transition) == (net, transition)]
            return len(fired) >= count

        try:
            self.wait_for(seen, f"{count} firings of {net}.{transition}")
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.under_way(begin)}") from error

    def under_way(self, begin):
        """What the machine tells where nothing happens: firings heard since ``begin``, commands, state of MCS."""
        from im_core.ros import qos
        from im_msgs.msg import McsState
        from im_msgs.srv import ListCommands

        heard = [f"{f.net}.{f.transition}" for f in self.firings[begin:]]
        listed = self.call(ListCommands, "/dispatcher/list_commands", 10.0)
        state = self.message(McsState, "/mcs/state", 10.0, qos.LATCHED)
        return f"heard {len(heard)} firings, last {heard[-5:]}; commands {listed.commands}; MCS {state}"

    def message(self, kind, topic, seconds=60.0, profile=None):
        from im_core.ros import qos

        received = []
        subscription = self.node.create_subscription(kind, topic, received.append, profile or qos.EVENTS)
        self.wait_for(lambda: received, topic, seconds)
        self.node.destroy_subscription(subscription)
        return received[0]

    def close(self):
        """The node and what it holds leave the graph."""
        import rclpy

        self.spinner.stop()
        rclpy.try_shutdown()


def report_of(answer):
    """The report of a calibration, as it is in its file."""
    return json.loads((Path(answer.report.directory) / "report.json").read_text())


def segments(pid):
    """Lines of the memory of a process about shared memory of Fast DDS."""
    return [line for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if "/fastrtps_" in line]
