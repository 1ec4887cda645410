"""Heartbeats of the machine's tasks: living tasks and incarnations."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from rclpy.qos import DurabilityPolicy, QoSProfile

from im.connection import PATIENCE_S, Connection
from im.errors import UnreachableError
from im_msgs.msg import TaskStatus

TOPIC = "/im/task_status"

#: Silence of a task that is no news yet on a busy computer [s].
FRESH_S = 6.0
#: Silence after which another incarnation of a task takes its name [s]: whoever says so earlier is a stranger.
_TAKES_OVER_S = 2.0
#: Tasks that are kept: anybody may publish made-up ones.
_MOST_TASKS = 1000

Watch = Callable[[float], str]
"""Returns why a task that is silent for so long [s] will not answer, as a clause; empty: it may."""


@dataclass(frozen=True)
class _Heard:
    at: float
    incarnation: int
    phase: int


class Heartbeats:
    """Last heartbeat of each task.

    Args:
        connection: Connection to the machine.
        watch: What this host knows of the machine; None: only what is heard.
    """

    def __init__(self, connection: Connection, watch: Watch | None = None) -> None:
        self._heard: dict[str, _Heard] = {}
        self._domain, self._watch = connection.domain, watch
        connection.living = self.living
        profile = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # the last one of each, at once
        connection.subscribe(TaskStatus, TOPIC, self.hear, profile)

    def tasks(self) -> dict[str, int]:
        """Return the phase of each task, as in ``im_msgs/msg/TaskStatus``."""
        return {name: heard.phase for name, heard in sorted(self._heard.items())}

    def incarnation(self, task: str) -> int:
        """Return the incarnation of a task; 0 for an unheard task."""
        heard = self._heard.get(task)
        return heard.incarnation if heard else 0

    def until(self, task: str, timeout: float) -> None:
        """Wait until a task is ready.

        Args:
            task: Name of the task.
            timeout: Longest wait [s], where nothing but the heartbeats is known of the machine.

        Raises:
            UnreachableError: The task is not ready in time.
        """
        began = time.monotonic()
        while not self._ready(task):
            waited = time.monotonic() - began
            if self._watch is None:
                self.require(task)
                if waited > timeout:
                    raise self._unheard(task, timeout)
            elif waited > FRESH_S and (why := self._watch(waited)):
                raise UnreachableError(f"{task} is missing{why}")
            time.sleep(0.02)

    def require(self, task: str, incarnation: int = 0) -> None:
        """Check for a chance of an answer by a task.

        Args:
            task: Name of the task; one that was never heard may answer.
            incarnation: Incarnation that was asked; 0: any may answer.

        Raises:
            UnreachableError: The task, or the whole machine, is silent, or another incarnation was asked.
        """
        heard = self._heard.get(task)
        if incarnation and heard and heard.incarnation != incarnation:
            raise UnreachableError(f"{task} died before it answered, and was started again")
        silent = time.monotonic() - heard.at if heard else 0.0
        if silent > FRESH_S and (why := (self._watch or self._why_silent)(silent)):
            raise UnreachableError(f"{task} is missing (last heard {silent:.1f} s ago){why}")

    def living(self, name: str) -> Callable[[], None]:
        """Return a check: does the present incarnation of a task still live?

        Args:
            name: Name of a service, an action or a topic, of which the first part is that of the task: ``/vss/snap``.
        """
        task = name.split("/")[1]
        return partial(self.require, task, self.incarnation(task))

    def hear(self, message: TaskStatus) -> None:
        """Take a heartbeat."""
        now, former = time.monotonic(), self._heard.get(message.name)
        if former is None:
            if len(self._heard) >= _MOST_TASKS:
                return
        elif former.incarnation != message.incarnation and now - former.at < _TAKES_OVER_S:
            return
        self._heard[message.name] = _Heard(now, int(message.incarnation), int(message.phase))

    def _ready(self, task: str) -> bool:
        heard = self._heard.get(task)
        return heard is not None and heard.phase == TaskStatus.READY and time.monotonic() - heard.at < FRESH_S

    def _why_silent(self, silent_s: float) -> str:
        if all(heard.phase == TaskStatus.STOPPING for heard in tuple(self._heard.values())):
            return ": the machine was stopped"
        if silent_s <= PATIENCE_S:
            return ""
        lives = any(time.monotonic() - heard.at < FRESH_S for heard in tuple(self._heard.values()))
        return "; other tasks of the machine live" if lives else ": the machine has ended"

    def _unheard(self, task: str, timeout: float) -> UnreachableError:
        if not self._heard:
            return UnreachableError.of_no_machine(self._domain, timeout)
        known = f"heard were: {', '.join(sorted(self._heard))}"
        return UnreachableError(f"{task} was not ready in ROS domain {self._domain} within {timeout:g} s; {known}")
