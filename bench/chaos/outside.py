"""Faults that come from outside the processes: messages, time, files, other programs."""

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from random import Random

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from bench.chaos import machine
from im_bringup.machine import leftovers
from im_core import clock
from im_core.errors import StateError
from im_core.processes.startup import STATUS_TOPIC
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.run import Spinner
from im_msgs.msg import Firing, NetDescription, TaskStatus, TokenPacket

#: Messages of right type and wrong content: topic, quality of service, and what is published.
MALFORMED = (
    (STATUS_TOPIC, qos.STATUS, TaskStatus(name="dispatcher", phase=77, detail="\x00" * 1000)),
    ("/pnt/nets", qos.LATCHED_MANY, NetDescription(net="chaos", json="[]")),
    ("/pnt/firings", qos.EVENTS, Firing(net="calibrate_camera", transition="", phase=99)),
    ("/dispatcher/tokens", qos.EVENTS, TokenPacket()),
    ("/testbed/lights", qos.LATCHED, String(data="{")),
)
LOAD_PROCESSES, LOAD_S = 6, 15.0
DISK_S = 8.0
_DISCOVERY_S, _CALL_S = 2.0, 30.0


@contextmanager
def _node() -> Iterator[Node]:
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node(f"chaos_{os.getpid()}", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def send_malformed() -> None:
    """Messages of right type and wrong content, twenty of each."""
    with _node() as node:
        publishers = [
            (node.create_publisher(type(message), topic, profile), message) for topic, profile, message in MALFORMED
        ]
        clock.sleep(_DISCOVERY_S)
        for _ in range(20):
            for publisher, message in publishers:
                publisher.publish(message)
            clock.sleep(0.02)


def jump_clock(hours: int) -> None:
    """Testbed time from a stranger: hours away from the true one, which is told in between."""
    with _node() as node:
        publisher = node.create_publisher(Clock, "/clock", 10)
        clock.sleep(_DISCOVERY_S)
        message = Clock()
        message.clock.sec = max(0, 3600 * hours)
        for _ in range(20):
            publisher.publish(message)
            clock.sleep(0.02)


def shut_mcs_down(motion_lost: Callable[[], None]) -> None:
    """The lifecycle transition *shutdown* of ``/mcs``, which nothing leads out of.

    Args:
        motion_lost: Is called when it was done.

    Raises:
        ImError: It is refused, or nobody answers.
    """
    with _node() as node, Spinner([node]):
        client = node.create_client(ChangeState, "/mcs/change_state")
        request = ChangeState.Request(transition=Transition(label="shutdown"))
        clock.sleep(_DISCOVERY_S)  # a server that has not discovered its client cannot answer
        answer = call_blocking(client, request, _CALL_S, "/mcs/change_state")
    if not answer.success:
        raise StateError("/mcs refuses the lifecycle transition shutdown")
    motion_lost()


def start_second() -> None:
    """Start a machine in the same ROS domain.

    Raises:
        StateError: It was not refused with the right sentence.
    """
    second = subprocess.run(
        [sys.executable, "-m", "im_bringup.machine.start"], capture_output=True, text=True, check=False
    )
    if second.returncode != 1 or "runs already" not in second.stderr:
        raise StateError(f"a second machine ended with code {second.returncode}: {second.stderr.strip()}")


def burn() -> None:
    """Programs that take the processors."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(LOAD_PROCESSES)]
    try:
        clock.sleep(LOAD_S)
    finally:
        for program in programs:
            program.kill()
            program.wait()


def stand_still(pauses: Iterable[tuple[float, float]]) -> None:
    """All processes of the machine stand still, and go on, at the same time.

    Args:
        pauses: After how long each time, and for how long [s].
    """
    for after_s, for_s in pauses:
        clock.sleep(after_s)
        pids = [process.pid for process in leftovers.processes()]
        machine.send(signal.SIGSTOP, pids)
        clock.sleep(for_s)
        machine.send(signal.SIGCONT, pids)


def fill_disk(role: str) -> None:
    """For one process every file is full for a while.

    Raises:
        StateError: There is no such process, or the system does not permit it.
    """
    pid = machine.pid_of(role)
    try:
        soft, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, hard))
        clock.sleep(DISK_S)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (soft, hard))
    except ProcessLookupError:
        return  # it ended of it, and is started again without
    except PermissionError as error:
        raise StateError(f"the files of {role} cannot be limited: {error}") from error


def damage_journal(role: str, draw: Random) -> None:
    """Kill a process and damage its journal before it is there again.

    It is cut at its end, has other bytes there, or is cut near its beginning, where header and snapshot are.

    Raises:
        StateError: There is no such process, or it keeps no journal.
    """
    journal = machine.journal_of(role)
    pid = machine.pid_of(role)
    way, length = draw.choice(("cut", "spoilt", "beheaded")), draw.randrange(1, 200)
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    if journal is None:
        raise StateError(f"{role} keeps no journal")
    size = journal.stat().st_size
    with journal.open("r+b") as file:
        if way == "cut":
            file.truncate(max(0, size - length))
        elif way == "beheaded":
            file.truncate(min(size, length))
        else:
            file.seek(max(0, size - length))
            file.write(draw.randbytes(min(length, size)))
