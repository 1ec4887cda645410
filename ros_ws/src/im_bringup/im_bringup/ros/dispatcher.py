"""Common base of the Dispatcher's clients: waits for the Dispatcher, and detects death and restart."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus

from im_bringup.machine import machine_state as machine
from im_bringup.machine.machine_state import MachineRecord
from im_bringup.ros.interruptible import InterruptibleNode
from im_core import clock
from im_core.errors import LinkError, StateError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.servers import reason
from im_core.startup import STATUS_TOPIC
from im_msgs.msg import TaskStatus
from im_msgs.srv import ListCommands

ACTION, LIST_SERVICE = "/dispatcher/execute", "/dispatcher/list_commands"
#: Longest wait for the service to be found, and longest silence of the dispatcher [s] of wall time: a dispatcher that
#: died is started again within a few seconds, on a busy computer later; one without a machine is not.
DISCOVERY_S = 60.0
SILENCE_S = 60.0
ALONE_S = 6.0
_POLL_S = 0.02
#: How long a dispatcher that was silent and lives may take to begin what it was asked for [s].
BEGINS_S = 20.0
#: Time after which a goal that met the server of a former incarnation is sent again [s].
ACCEPT_S = 2.0
#: What goes on where a user no longer waits.
GOES_ON = "; the machine goes on with the command"


@dataclass(frozen=True)
class DispatcherMoment:
    """A moment in an incarnation of a Dispatcher.

    Attributes:
        last: The largest number that a command had been given.
        incarnation: Which incarnation it was.
    """

    last: int
    incarnation: int


class DispatcherClient(InterruptibleNode):
    """Client waiting through a death and restart of the Dispatcher; waits for a silent one while the machine runs.

    Args:
        name: Begins the name of its node.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._heard = clock.monotonic()
        self._incarnation = 0
        self._list = self.create_client(ListCommands, LIST_SERVICE)
        self.create_subscription(TaskStatus, STATUS_TOPIC, self._hear, qos.STATUS)

    def listed(self) -> ListCommands.Response:
        """Request the list of commands; ask again if a restarted Dispatcher does not know the client yet.

        Raises:
            LinkError: The dispatcher fell silent.
            WaitTimeoutError: It does not answer.
        """
        deadline, answer = clock.monotonic() + SILENCE_S, None
        while answer is None:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"an answer of {LIST_SERVICE}", seconds=SILENCE_S)
            self._until(self._can_list, f"the service {LIST_SERVICE}")
            answer = self._answer(self._list.call_async(ListCommands.Request()), ACCEPT_S)
        told: ListCommands.Response = answer
        return told

    def moment(self) -> DispatcherMoment:
        """Return the last command number and the incarnation of the Dispatcher at present.

        Raises:
            LinkError: The dispatcher fell silent.
            WaitTimeoutError: It does not answer.
        """
        return DispatcherMoment(self.listed().last, self._incarnation)

    def begun_since(self, before: DispatcherMoment, symbol: str) -> int:
        """Return the number of a command requested before the death or silence of the dispatcher.

        Args:
            before: When it was asked.
            symbol: What for.

        Raises:
            StateError: No command was begun, or several were.
            LinkError: The dispatcher fell silent.
            WaitTimeoutError: It does not answer.
        """
        deadline = clock.monotonic() + BEGINS_S
        while not (new := _begun(self.listed(), before.last, symbol)):
            if self._incarnation != before.incarnation or clock.monotonic() > deadline:
                raise StateError(f"the dispatcher stopped before it recorded command {symbol}; run the command again")
            self.pause(1.0)
        if len(new) > 1:
            which = f"the dispatcher was restarted; this {symbol} is one of the commands {', '.join(map(str, new))}"
            raise StateError(f"{which}: im run lists those under way, and attaches to one by its number")
        return new[0]

    def _can_list(self) -> bool:
        return self._dispatcher_there() and self._list.service_is_ready()

    def _dispatcher_there(self) -> bool:
        """Check whether the dispatcher can be asked: heard before (or a death goes unnoticed), and not starting."""
        return bool(self._incarnation) and not _starting(machine.read())

    def _result(self, answer: Any | None) -> Any | None:
        """Return the result in the answer to a goal; None if the dispatcher was away and no longer knows the goal."""
        if answer is None or answer.status == GoalStatus.STATUS_UNKNOWN:
            return None
        if not answer.result.success:
            answer.result.status.message = reason(self, answer.result.status.message, ACTION)
        return answer.result

    def _answer(self, future: Any, limit_s: float = math.inf) -> Any | None:
        """Return the result of a future completed by the dispatcher, None after a restart or a timeout.

        Args:
            future: It.
            limit_s: Longest wait [s].

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            LinkError: The dispatcher fell silent.
        """
        begun, known = clock.monotonic(), self._incarnation
        self._heard = begun
        while not future.done():
            self.pause(_POLL_S)
            if clock.monotonic() - begun > limit_s:
                return None
            silent = clock.monotonic() - self._heard
            if silent > ALONE_S and (why := _why_lost(silent)):
                raise LinkError(f"the dispatcher is missing (last heard {silent:.1f} s ago){why}")
            if self._incarnation != known:
                return None
        return future.result()

    def _until(self, ready: Callable[[], bool], what: str, seconds: float = DISCOVERY_S) -> None:
        there = clock.monotonic()

        def ready_yet() -> bool:
            nonlocal there
            if ready():
                return True
            now = clock.monotonic()
            if not (why := _why_lost(0.0)):
                there = now
            elif now - there > ALONE_S:
                raise LinkError(f"{what} is missing{why}")
            return False

        super()._until(ready_yet, what, seconds)

    def _may_yet_come(self) -> bool:
        """Check whether a late answer may still come: True while the machine is being started."""
        return _starting(machine.read())

    def _hear(self, message: TaskStatus) -> None:
        if message.name == "dispatcher" and self._is_vouched(message.incarnation):
            self._heard, self._incarnation = clock.monotonic(), message.incarnation

    def _is_vouched(self, incarnation: int) -> bool:
        """Return whether the machine record of the local host, if there is one, has the same incarnation."""
        if incarnation == self._incarnation:
            return True
        record = machine.read()
        return record is None or record.incarnations.get("dispatcher", incarnation) == incarnation


def _begun(told: ListCommands.Response, last: int, symbol: str) -> list[int]:
    """Return the numbers of a symbol's commands after a number; of ended ones only the last, of any symbol."""
    new = {command.command_id: command.symbol for command in told.commands if command.command_id > last}
    if told.last > last:
        new.setdefault(told.last, symbol)
    return [number for number, name in new.items() if name == symbol]


def _starting(record: MachineRecord | None) -> bool:
    """Whether the machine is being started, perhaps again."""
    return record is not None and record.alive and record.state == machine.STARTING


def _why_lost(silent_s: float) -> str:
    """Return why a dispatcher silent for a given time will not answer, as a clause; empty if an answer may come."""
    record = machine.read()
    if record is None or not record.alive:
        return ": the machine has ended, its bootstrap is gone"
    return "" if silent_s <= SILENCE_S or _starting(record) else f"; the machine is {record.state}"
