"""Commands of the Dispatcher: begun, followed through the death of the Dispatcher, and ended."""

import contextlib
import json
import math
import queue
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from action_msgs.msg import GoalStatus
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from im.connection import PATIENCE_S, Connection
from im.errors import CommandCancelledError, CommandFailedError, MachineError, UnreachableError
from im.heartbeats import Heartbeats
from im.messages import message_of
from im.waits import next_of, wait_for
from im_msgs.action import ExecuteCommand
from im_msgs.srv import ControlCommand, ListCommands

ACTION = "/dispatcher/execute"
DISPATCHER = "dispatcher"

#: How often a command is looked after [s]: for its end, and for a death of the Dispatcher.
_LOOK_S = 0.05
#: After so long [s] a goal without an answer is sent again, and a result asked for again: a new server may not have
#: known the client yet, and a dead one took no goal.
_GOAL_AGAIN_S, _RESULT_AGAIN_S = 2.0, 10.0
#: Words that a step tells come within so long [s].
_WORDS_S = 0.2
#: How long a restarted Dispatcher may take to take up a command that it had written down [s].
_TAKES_UP_S = 20.0


@dataclass(frozen=True)
class Progress:
    """Progress of a command.

    Attributes:
        command: The command.
        fraction: 0 to 1; None where unknown.
        step: Transition that fired last.
        message: Text of the command.
        state: waiting, running, paused or cancelling.
    """

    command: "Command"
    fraction: float | None
    step: str
    message: str
    state: str

    @property
    def result(self) -> Any:
        """The result of the command; waits for the end."""
        return self.command.result

    def __str__(self) -> str:
        """Return fraction, state and message in a line; empty if there is nothing to tell."""
        fraction = f"[{100 * self.fraction:3.0f} %] " if self.fraction is not None else ""
        state = "" if self.state == "running" else self.state
        told = ": ".join(filter(None, (state, self.message or self.step)))
        return f"{fraction}{told}" if told else ""


class Command:
    """Command of the Dispatcher, begun or attached to.

    Iterate for progress, ask for :attr:`result` to wait; ``async for`` and ``await`` do the same. Ctrl-C during a
    wait cancels the command, and a second one leaves the command alone.

    Attributes:
        symbol: Name of the command; empty where only the number is known.
        attached: Whether the command was attached to.
    """

    def __init__(self, connection: Connection, heartbeats: Heartbeats, goal: ExecuteCommand.Goal) -> None:
        """Begin a command.

        Args:
            connection: Connection to the machine.
            heartbeats: Heartbeats of the tasks.
            goal: The command, or the number to attach to.

        Raises:
            UnreachableError: No Dispatcher.
        """
        self.symbol, self.attached = str(goal.symbol), bool(goal.attach)
        self._connection, self._heartbeats, self._number = connection, heartbeats, int(goal.command_id)
        self._told: queue.SimpleQueue[Progress | None] = queue.SimpleQueue()
        self._begun, self._ended, self._cancelling = threading.Event(), threading.Event(), threading.Event()
        self._outcome: ExecuteCommand.Result | None = None
        self._error: MachineError | None = None
        heartbeats.until(DISPATCHER, PATIENCE_S)
        self._last = 0 if self._number else int(self._listed().last)
        self._asked_of = heartbeats.incarnation(DISPATCHER)
        self._thread = threading.Thread(target=self._follow, args=(goal,), name=f"{self.symbol}", daemon=True)
        self._thread.start()
        if self._number:
            self._begun.set()

    @property
    def number(self) -> int:
        """Number of the command; waits for the record of the Dispatcher; 0 for a refused command."""
        wait_for(self._begun)
        return self._number

    @property
    def begun(self) -> bool:
        """Whether the Dispatcher has written the command down; does not wait."""
        return bool(self._number)

    @property
    def ended(self) -> bool:
        """Whether the command has ended."""
        return self._ended.is_set()

    @property
    def result(self) -> Any:
        """The results of the command; waits for the end.

        Raises:
            CommandFailedError: The command failed, or was refused.
            CommandCancelledError: The command was cancelled.
            MachineError: The Dispatcher was lost, or does not know the command.
        """
        self.wait()
        if self._error is not None:
            raise self._error
        return self._read(json.loads(self.outcome.results or "{}"))

    @property
    def outcome(self) -> ExecuteCommand.Result:
        """Outcome told by the Dispatcher, also of a failed command; waits for the end.

        Raises:
            MachineError: As of :attr:`result`, but for a failure.
        """
        self.wait()
        if self._outcome is None:
            raise self._error or MachineError(f"command {self.symbol} has no outcome")
        return self._outcome

    @property
    def cancelling(self) -> bool:
        """Whether the client has asked for the end of the command."""
        return self._cancelling.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the end; return whether the command has ended.

        Args:
            timeout: Longest wait [s]; None: until the end.
        """
        with self._cancelled_by_interrupt():
            return wait_for(self._ended, timeout)

    def pause(self) -> str:
        """Let running actions end, and begin no more; return the change.

        Raises:
            MachineError: The request was refused.
        """
        return self._control("pause")

    def resume(self) -> str:
        """Go on after a pause; return the change.

        Raises:
            MachineError: The request was refused.
        """
        return self._control("resume")

    def abandon(self) -> str:
        """End the command at once, though nothing fires; return what its tokens held, and what was in doubt.

        The last resort, where a cancellation changes nothing: actions under way are cancelled and not awaited.

        Raises:
            MachineError: The request was refused.
        """
        return self._control("abandon")

    def cancel(self) -> None:
        """Ask for the end of the command, also through a death of the Dispatcher; closing steps of the net follow."""
        self._cancelling.set()

    def progress(self) -> Iterator[Progress]:
        """Iterate over the progress until the end, or a failure; Ctrl-C only ends the iteration.

        A step and the words that its action tells at once are one.
        """
        progress = next_of(self._told)
        while progress is not None:
            following: Progress | None = progress
            if progress.step and not progress.message:
                with contextlib.suppress(queue.Empty):
                    following = self._told.get(timeout=_WORDS_S)
            if following is progress or following is None or following.step != progress.step:
                yield progress
            progress = following if following is not progress else next_of(self._told)
        self._told.put(None)

    def __iter__(self) -> Iterator[Progress]:
        """Iterate over the progress that has something to tell, until the end.

        Raises:
            MachineError: As of :attr:`result`.
        """
        with self._cancelled_by_interrupt():
            yield from filter(str, self.progress())
        _ = self.result

    async def __aiter__(self) -> AsyncIterator[Progress]:
        """Iterate over the progress until the end, without blocking the loop."""
        import asyncio

        each = filter(str, self.progress())
        while (progress := await asyncio.to_thread(next, each, None)) is not None:
            yield progress
        _ = self.result

    def __await__(self) -> Generator[Any, None, Any]:
        """Await the result; a cancelled await cancels the command."""
        return self._awaited().__await__()

    async def _awaited(self) -> Any:
        import asyncio  # a tenth of the start of a client, few of which use it

        try:
            while not self.ended:
                await asyncio.sleep(_LOOK_S)
        except asyncio.CancelledError:
            self.cancel()
            raise
        return self.result

    def _read(self, results: dict[str, Any]) -> Any:
        return results

    @contextlib.contextmanager
    def _cancelled_by_interrupt(self) -> Iterator[None]:
        try:
            yield
        except KeyboardInterrupt:
            if not self.ended and not self.cancelling:
                print(f"im: cancelling {self.symbol}; interrupt again to leave it alone", file=sys.stderr)
                self.cancel()
                wait_for(self._ended)
            raise

    def _control(self, request: str) -> str:
        if not self.number:
            raise self._error or MachineError(f"command {self.symbol} was not begun", "state")
        return control(self._connection, self._number, request)

    def _follow(self, goal: ExecuteCommand.Goal) -> None:
        """Follow the command to the end; in a thread of the command."""
        try:
            outcome = self._outcome_of(goal)
            while outcome is None:  # the Dispatcher died: a command that was written down goes on in the next one
                if not self._number:
                    self._number = self._begun_since()
                    self._begun.set()
                back = f"the dispatcher died and is back; attaching to number {self._number}"
                self._told.put(Progress(self, None, "", back, "running"))
                again = message_of(ExecuteCommand.Goal, attach=True, command_id=self._number, symbol=self.symbol)
                outcome = self._outcome_of(again)
            self._outcome = outcome
            if not outcome.success:
                kind = CommandCancelledError if outcome.status.code == "cancelled" else CommandFailedError
                self._error = kind(self.symbol, self._number, outcome.status, json.loads(outcome.results or "{}"))
        except MachineError as error:
            self._error = error
        except Exception as error:  # the waiter must be told
            self._error = MachineError(f"command {self.symbol} is no longer followed: {error!r}")
        finally:
            self._ended.set()
            self._begun.set()
            self._told.put(None)

    def _outcome_of(self, goal: ExecuteCommand.Goal) -> ExecuteCommand.Result | None:
        """Send a goal, and return the outcome; None if the Dispatcher died and does not know the goal.

        Raises:
            UnreachableError: The Dispatcher is silent.
        """
        self._heartbeats.until(DISPATCHER, PATIENCE_S)
        action = self._connection.action(ExecuteCommand, ACTION)
        known, goal_id = self._heartbeats.incarnation(DISPATCHER), UUID(uuid=list(uuid4().bytes))

        def send() -> Future:
            sent: Future = action.send_goal_async(goal, feedback_callback=self._take, goal_uuid=goal_id)
            return sent

        handle = self._asked(send, known, _GOAL_AGAIN_S)
        if handle is None:
            return None
        # also where a goal that was sent twice was refused the second time
        answer = self._asked(handle.get_result_async, known, _RESULT_AGAIN_S, handle.cancel_goal_async)
        if answer is None or answer.status == GoalStatus.STATUS_UNKNOWN:
            return None
        outcome: ExecuteCommand.Result = answer.result
        if not outcome.success and not outcome.status.message:
            outcome.status.message = f"the server of {ACTION} gave no reason"
        return outcome

    def _asked(
        self, ask: Callable[[], Future], known: int, again_s: float, cancel: Callable[[], object] | None = None
    ) -> Any | None:
        """Ask now and then, and return the first answer; None if the Dispatcher has a new incarnation.

        Args:
            ask: Asks; called in the thread of the connection.
            known: Incarnation of the Dispatcher.
            again_s: When to ask again [s].
            cancel: Asks for the cancellation, once it is wanted.

        Raises:
            UnreachableError: The Dispatcher is silent.
        """
        answers: queue.SimpleQueue[Future] = queue.SimpleQueue()
        asked = -math.inf
        while True:
            if time.monotonic() - asked > again_s:
                asked = time.monotonic()
                self._connection.inside(lambda: ask().add_done_callback(answers.put))
            if cancel is not None and self._cancelling.is_set():
                self._connection.inside(cancel)
                cancel = None
            with contextlib.suppress(queue.Empty):
                return answers.get(timeout=_LOOK_S).result()
            if self._heartbeats.incarnation(DISPATCHER) != known:
                return None
            self._heartbeats.require(DISPATCHER)

    def _take(self, message: Any) -> None:
        feedback = message.feedback
        if not self._number:
            self._number = int(feedback.command_id)
        self._begun.set()
        fraction = float(feedback.progress) if feedback.progress > 0 else None
        self._told.put(Progress(self, fraction, feedback.step, feedback.message, feedback.state))

    def _begun_since(self) -> int:
        """Return the number of a command requested before the death of the Dispatcher.

        Raises:
            MachineError: No command was written down, or several were.
        """
        deadline = time.monotonic() + _TAKES_UP_S
        while True:
            listed = self._listed()
            new = {state.command_id: state.symbol for state in listed.commands if state.command_id > self._last}
            if listed.last > self._last:
                new.setdefault(listed.last, self.symbol)
            numbers = [number for number, symbol in new.items() if symbol == self.symbol]
            if len(numbers) == 1:
                return numbers[0]
            if numbers:
                which = f"this {self.symbol} is one of the commands {', '.join(map(str, numbers))}"
                raise MachineError(f"the dispatcher was restarted; {which}", "state")
            if time.monotonic() > deadline or self._heartbeats.incarnation(DISPATCHER) != self._asked_of:
                why = f"the dispatcher stopped before it recorded command {self.symbol}; run the command again"
                raise MachineError(why, "state")
            time.sleep(1.0)

    def _listed(self) -> ListCommands.Response:
        """Return the list of commands, asked again where a restarted Dispatcher lost the request."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                listed: ListCommands.Response = self._connection.call(
                    ListCommands, "/dispatcher/list_commands", _GOAL_AGAIN_S
                )
                return listed
            except UnreachableError:
                self._heartbeats.require(DISPATCHER)
                if time.monotonic() > deadline:
                    raise

    def __repr__(self) -> str:
        """Return symbol, number and state."""
        state = "ended" if self.ended else "under way"
        return f"<command {self._number or '?'}: {self.symbol}, {state}>"


def control(connection: Connection, number: int, request: str) -> str:
    """Cancel, pause, resume or abandon a command; return the change.

    Raises:
        MachineError: The request was refused.
    """
    answer = connection.call(ControlCommand, "/dispatcher/control_command", command_id=number, request=request)
    if not answer.success:
        raise MachineError(answer.message or "the server of /dispatcher/control_command gave no reason", "state")
    return str(answer.message)
