"""Tokens and the validity of the objects for which they stand agree again, whoever was killed at whatever moment."""

import contextlib
import os
import random
import subprocess
import sys

import pytest
import rclpy
from rclpy.parameter import Parameter

from im_core import clock
from im_core.errors import WaitTimeoutError
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_msgs.msg import Marking
from im_msgs.srv import InvalidateObject, ListObjects
from support.keeper import OBJECTS

#: How long a process may take to come back and have looked at all [s].
PATIENCE_S = 120.0


class Onlooker(ManagedNode):
    """Has objects lose their validity, and sees the marking."""

    def __init__(self) -> None:
        super().__init__("onlooker", parameter_overrides=[Parameter("standalone", value=True)])
        self.marked: dict[str, int] = {}
        self.create_subscription(Marking, "/pnt/markings", self._hear, qos.LATCHED_MANY)
        self._invalidate = self.create_client(InvalidateObject, "/dom/invalidate", qos_profile=qos.QUEUED_SERVICE)
        self._list = self.create_client(ListObjects, "/dom/list", qos_profile=qos.QUEUED_SERVICE)

    def _hear(self, marking: Marking) -> None:
        self.marked = dict(zip(marking.places, marking.tokens, strict=True))

    def invalidate(self, name: str) -> None:
        """Has an object lose its validity, unless /dom is just dead."""
        with contextlib.suppress(WaitTimeoutError):
            call_blocking(self._invalidate, InvalidateObject.Request(name=name, source="onlooker"), 1.0, "to forget")

    def valid(self) -> set[str]:
        """The objects that are valid, as /dom says; an answer that is lost is asked for again."""
        for _ in range(30):
            with contextlib.suppress(WaitTimeoutError):
                answer = call_blocking(self._list, ListObjects.Request(), 4.0, "the objects")
                assert answer.success, answer.status.message
                return {info.name for info in answer.objects if info.valid}
        return pytest.fail("/dom does not answer")

    def shown(self) -> set[str]:
        """The objects for which a token stands."""
        return {name for name in OBJECTS if self.marked.get(f"there_{name}")}


class Processes:
    """/dom and a node whose places stand for objects."""

    def __init__(self, folder) -> None:
        self._modules = {"dom": ["im_dom.ros.node"], "keeper": ["support.keeper", str(folder)]}
        self._environment = {**os.environ, "IM_RUN_DIR": str(folder)}
        self._running = {name: self._start(name) for name in self._modules}

    def _start(self, name):
        alone = ["--ros-args", "-p", "standalone:=true"]
        return subprocess.Popen([sys.executable, "-m", *self._modules[name], *alone], env=self._environment)

    def kill(self, *names) -> None:
        """Kills processes at once, and starts them again."""
        for name in names:
            self._running[name].kill()
        for name in names:
            self._running[name].wait()
            self._running[name] = self._start(name)

    def end(self) -> None:
        for process in self._running.values():
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    rclpy.init()
    onlooker, processes = Onlooker(), Processes(tmp_path_factory.mktemp("validity"))
    with spin_in_thread(onlooker):
        yield onlooker, processes
    processes.end()
    rclpy.try_shutdown()


@pytest.mark.parametrize("seed", range(2))
def test_a_token_and_the_validity_of_its_object_agree_after_kills_at_seeded_moments(scene, seed):
    onlooker, processes = scene
    draw = random.Random(seed)
    for _ in range(6):
        clock.sleep(draw.choice((0.0, 0.05, 0.5, 2.0)))
        match draw.choice(("dom", "keeper", "both", "invalidate", "invalidate", "invalidate")):
            case "both":
                processes.kill("dom", "keeper")
            case "invalidate":
                for name in draw.sample(OBJECTS, draw.choice((1, 2, 3))):
                    onlooker.invalidate(name)
            case name:
                processes.kill(name)
    deadline, agreed = clock.monotonic() + PATIENCE_S, 0
    while agreed < 3:  # once might be before something is noticed
        shown, valid = onlooker.shown(), onlooker.valid()
        agreed = agreed + 1 if shown == valid == set(OBJECTS) else 0
        assert clock.monotonic() < deadline, f"tokens stand for {sorted(shown)}, and {sorted(valid)} are valid"
        clock.sleep(0.2)
