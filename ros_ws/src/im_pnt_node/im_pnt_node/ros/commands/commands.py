"""The commands of a node's nets: the waiting clients, the listeners, and the ends of the last ones."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from diagnostic_msgs.msg import KeyValue

from im_core.clock import stamp_name, wall
from im_core.errors import FOREIGN, ArgumentError, ImError, NotFoundError, StateError
from im_core.ros.coroutines import Promise
from im_core.ros.dom import DomClient
from im_core.ros.messages.status import ok_status, to_status
from im_core.ros.node import ManagedNode
from im_core.unfinished_commands import OpenCommandNote, noted, set_aside
from im_msgs.msg import Status
from im_pnt.errors import JournalError, NetError
from im_pnt.execution.abandonment import abandonment
from im_pnt.execution.events import CommandCancelled, CommandHeld
from im_pnt.execution.executor import Executor
from im_pnt.execution.firing.rule import ADDRESS
from im_pnt.execution.jobs import Command, CommandResult, Job
from im_pnt.execution.journal_entries import plain_dict
from im_pnt.execution.notification import Firing, Phase
from im_pnt_node.journal.ended import EndedCommand, EndedCommands
from im_pnt_node.ros.commands.notes import CommandNotes
from im_pnt_node.ros.execution.loop import NetLoop
from im_pnt_node.ros.objects.scopes import CommandScopes

ANSWER_S = 3.0
"""How long who cancels, pauses or operates waits for a journal that cannot be written [s]."""
NOT_OBEYED = "it was asked to end early, and its net went on to the end all the same"
MOST_EVENTS = 5
"""Events that are told with the failure of a command."""

ProgressListener = Callable[[str, str, float], None]
"""Is told the transition that fired or reported, a text, and the progress 0..1 (negative: unknown)."""


@dataclass(frozen=True)
class CommandOutcome:
    """Outcome of a command, for the client."""

    success: bool
    status: Status
    results: dict[str, object]


@dataclass
class OpenCommand:
    """Command without an end.

    Attributes:
        job: What the net that reads it has of it.
        net: That net.
        step: Transition that fired last for it.
        text: What it told last.
        progress: Progress 0..1, negative where unknown.
    """

    job: Job
    net: Executor
    step: str = ""
    text: str = ""
    progress: float = -1.0

    @property
    def held(self) -> bool:
        """Whether nothing more is begun for the command."""
        return self.net.rule.is_held(self.job)

    @property
    def state(self) -> str:
        """Progress of the command, in a word."""
        if self.job.cancelled:
            return "cancelling"
        if self.held:
            return "paused"
        return "waiting" if self.job.waiting else "running"


class Commands:
    """Writer of commands to the input tapes of a node's nets, with the open ones.

    Where several nets know a symbol, the first of them reads it; it may hand the command on to another.

    Args:
        node: The node.
        nets: Its nets by name; looked at anew for each command.
        loop: Has the nets go on, and writes their journal.
        dom: Keeps the data objects of commands.
        run_dir: Folder of the machine, where commands that have not ended are noted; None: nowhere.

    Attributes:
        lost: Why commands of a former incarnation of the node are forgotten, a clause; empty if they are not.
        ended: Those that have ended.
    """

    def __init__(
        self, node: ManagedNode, nets: Mapping[str, Executor], loop: NetLoop, dom: DomClient, run_dir: Path | None
    ) -> None:
        self._node, self._nets, self._loop, self._run_dir = node, nets, loop, run_dir
        self._notes = CommandNotes(node, run_dir, self.noted)
        self._scopes = CommandScopes(node, dom, self.scopes)
        self.lost = ""
        self.ended = EndedCommands()
        self._count = 0
        self._incarnation = stamp_name()
        self._open: dict[int, OpenCommand] = {}
        self._events: dict[int, list[str]] = {}  # while a command was under way, by its number
        self._waiting: dict[int, list[Promise]] = {}
        self._listeners: dict[int, list[ProgressListener]] = {}

    @property
    def last(self) -> int:
        """The largest number of any command, of all incarnations of the node; 0: there was none."""
        return max(self.ended.largest(), *self._open, 0)

    def symbols(self) -> list[str]:
        """Return the symbols read by the nets from the tapes."""
        return sorted({symbol for executor in self._nets.values() for symbol in executor.net.symbols()})

    def scopes(self) -> frozenset[str]:
        """Return the name prefixes of the data objects of open commands."""
        return frozenset(each.job.command.scope for each in self._open.values())

    def running(self, symbol: str) -> Job | None:
        """Return the oldest open command of a symbol, if any."""
        return next((each.job for each in self._open.values() if each.job.command.symbol == symbol), None)

    def open(self) -> list[OpenCommand]:
        """Return the open commands, in the order of the numbers."""
        return [self._open[number] for number in sorted(self._open)]

    def noted(self) -> list[OpenCommandNote]:
        """Return the notes of the commands not yet ended, in the order of the numbers."""
        task = self._node.task_name
        return [OpenCommandNote(task, each.job.command.id, each.job.symbol, each.progress) for each in self.open()]

    def get(self, number: int) -> OpenCommand:
        """Return an open command.

        Raises:
            StateError: There is none of that number.
        """
        if number not in self._open:
            known = ", ".join(f"{each.job.command.symbol} (number {n})" for n, each in sorted(self._open.items()))
            under_way = f"under way are {known}" if known else "none is under way"
            if number in self.ended:
                raise StateError(
                    f"{self.ended[number].symbol} (number {number}) has ended; {under_way}", command_id=number
                )
            raise StateError(f"no command has the number {number}; {under_way}{self._forgotten()}", command_id=number)
        return self._open[number]

    def take_up(self) -> None:
        """Enter the commands restored from a journal, or taken over from a replaced net."""
        for executor in self._nets.values():
            for job in executor.jobs():
                if job.is_command:
                    number = job.command.id
                    known = self._open.get(number)
                    self._open[number] = OpenCommand(job, executor)
                    if known is not None:
                        self._open[number].step, self._open[number].text = known.step, known.text
                    job.on_closed = self._closing(number, job.command.symbol)
        entered = sum(executor.rule.ledger.count for executor in self._nets.values())
        self._count = max(self._count, entered, self.ended.largest(), *self._open)  # so that no number is given twice
        self._notes.changed()

    def restore(self, lost: str, *, sync: bool) -> None:
        """Enter the commands of the journal; end those that are unknown to it, or of an abandoned mission.

        A client still asking for one of these hears the end.

        Args:
            lost: Why what was journalled is forgotten, a clause; empty if it is not.
            sync: Whether an end that is written down waits for the disk.
        """
        self.lost, task = lost, self._node.task_name
        before: list[OpenCommandNote] = []
        if self._run_dir is not None:
            before = [each for each in noted(self._run_dir) if each.task == task]
            self.ended.keep_in(self._run_dir / "ended" / f"{task}.jsonl", sync=sync)
            for command, folder in set_aside(self._run_dir):
                if command.task == task and command.number not in self.ended:
                    why = f"the machine was started anew before it had ended; what it has left is kept in {folder}"
                    self._end_unfinished(command, ImError(why, code="set_aside"))
        self.take_up()
        lacks = lost or f"the journal of {task} does not know it: it is gone or an old copy, or has lost its end"
        for command in before:
            if command.number not in self._open and command.number not in self.ended:
                words = f"{command.symbol} (number {command.number}) was under way when {task} ended: {lacks}"
                self._end_unfinished(command, ImError(words, code="forgotten"))
                self._count = max(self._count, command.number)

    def _end_unfinished(self, command: OpenCommandNote, error: ImError) -> None:
        self.ended.add(_ended(command.number, command.symbol, CommandResult(False, error, {})))

    def begin(self) -> None:
        """Delete the data objects of commands of former incarnations, once ``/dom`` is there."""
        self._node.spawn(self._scopes.begin())

    def end(self) -> None:
        """Note the commands under way for the next start, and cancel them: the node ends."""
        self._notes.write_last()
        error = ImError(f"{self._node.task_name} is shutting down", code="cancelled")
        for executor in self._nets.values():
            executor.post(CommandCancelled(None, error))

    def reader(self, symbol: str, arguments: Mapping[str, object] | None = None) -> Executor:
        """Return the net reading a symbol.

        Args:
            symbol: The symbol; several nets may read it as a word to their commands.
            arguments: What comes with it; they may say for which command it is meant.

        Raises:
            NotFoundError: None does.
        """
        readers = [executor for executor in self._nets.values() if symbol in executor.net.symbols()]
        if not readers:
            raise NotFoundError(kind="command", name=symbol, known=self.symbols())
        meant = (arguments or {}).get(ADDRESS)
        readers.sort(key=lambda each: bool(each.written.former) is (symbol in each.written.begun_symbols()))
        at_work = (each for each in readers if any(job.command.id == meant for job in each.jobs()))
        return next(at_work, readers[0]) if meant is not None else readers[0]

    async def run(
        self,
        symbol: str,
        arguments: Mapping[str, object] | None = None,
        listener: ProgressListener | None = None,
        started: Callable[[int], None] | None = None,
        priority: int = 0,
    ) -> CommandOutcome:
        """Write a command to the input tape and wait until the net emits ``<symbol>_done`` or ``<symbol>_failed``.

        Args:
            symbol: Symbol of the command.
            arguments: What actions find in ``ctx.command.arguments``.
            listener: Is told of progress.
            started: Is told the number of the command, by which it can be cancelled.
            priority: Larger goes first, where commands wait for the same.

        Raises:
            StateError: The node has failed, as with a net that is wrong.
            NotFoundError: No net knows the symbol.
            DataError: The arguments are not what the net declares.
            JournalError: The journal cannot be written: the command would not even begin.
        """
        if self._node.failed:
            raise StateError(f"{self._node.task_name} has failed: {self._node.failed}")
        if self._loop.journal is not None:
            self._loop.journal.require_writable()
        number = self.write(symbol, arguments or {}, priority)
        if started is not None:
            started(number)
        return await self.wait(number, listener)

    def write(self, symbol: str, arguments: Mapping[str, object], priority: int = 0) -> int:
        """Write a command to the tape of the net of the symbol; return the number.

        Raises:
            NotFoundError: No net knows the symbol.
            DataError: The arguments are not what the net declares.
        """
        executor = self.reader(symbol, arguments)
        number = self._count + 1
        scope = f"{self._node.task_name}/{self._incarnation}-{number}"
        command = Command(number, symbol, dict(arguments), priority=priority, scope=scope)
        job = executor.command(command, self._closing(number, symbol))
        self._count = number
        self._open[number] = OpenCommand(job, executor)
        self._node.get_logger().info(f"command {number}: {symbol}")
        self._notes.changed()
        return number

    def cancel(self, number: int, why: str = "cancelled by its client") -> None:
        """Ask a command to end early, also a paused one; the nets decide how."""
        error = ImError(why, code="cancelled", command_id=number)
        for executor in self._nets.values():
            executor.post(CommandCancelled(number, error))

    def abandon(self, number: int) -> str:
        """End a command at once, though nothing fires; return what it held, and what was in doubt.

        Raises:
            StateError: There is no open command of the number.
        """
        asked = self.get(number).job.command
        error = abandonment(self._nets.values(), asked, "abandoned by the operator")
        for executor in self._nets.values():
            executor.post(CommandCancelled(number, error))
        return error.message

    def hold(self, number: int, held: bool) -> None:
        """Begin nothing more for a command (running actions end), or let the command go on.

        Raises:
            StateError: It is to be held, and has ended.
        """
        scope = self.get(number).job.command.scope if held else ""
        for executor in self._nets.values():
            if held != (number in executor.rule.held):
                executor.post(CommandHeld(number, held, scope))

    async def written(self, longest_s: float = math.inf) -> None:
        """Wait until a request is in the journal, and noted for the next start of the machine.

        Args:
            longest_s: Longest wait for a journal that cannot be written [s].

        Raises:
            JournalError: It cannot be written.
        """
        await self._loop.written(longest_s)
        await self._notes.written()

    async def on_file(self) -> str:
        """Wait likewise, but briefly; return a remark for an answer: empty, or the reason for not being on file."""
        try:
            await self.written(ANSWER_S)
        except JournalError as error:
            return f"; it is done, but not on file: {error.message}"
        return ""

    async def wait(self, number: int, listener: ProgressListener | None = None) -> CommandOutcome:
        """Wait until a command has ended."""
        promise = self._node.promise()
        self._waiting.setdefault(number, []).append(promise)
        if listener is not None:
            self._listeners.setdefault(number, []).append(listener)
        outcome: CommandOutcome = await promise
        return outcome

    async def attach(
        self,
        symbol: str,
        listener: ProgressListener | None = None,
        started: Callable[[int], None] | None = None,
        number: int = 0,
    ) -> CommandOutcome:
        """Wait for an open command, or return the end of a former one, or of the last one of the symbol.

        Args:
            symbol: Symbol of the command.
            listener: Is told of progress.
            started: Is told the number of the running command.
            number: Number of the command; 0: the oldest of its symbol.

        Raises:
            StateError: There is none, and it is not known how one has ended; or it is one of another symbol.
            NotFoundError: No net knows the symbol, and none has ended of it.
            ArgumentError: Neither number nor symbol is given.
        """
        if number:
            over = number not in self._open and number in self.ended
            found = self.ended[number].symbol if over else self.get(number).job.command.symbol
            if symbol not in ("", found):
                raise StateError(f"number {number} is {found}, not {symbol}", command_id=number, command=found)
            if over:
                return _outcome(self.ended[number])
            job: Job | None = self.get(number).job
        else:
            if not symbol:
                raise ArgumentError("to attach needs the number or the symbol of a command")
            if self.ended.last(symbol) is None:
                self.reader(symbol)
            job = self.running(symbol)
        if job is not None:
            if started is not None:
                started(job.command.id)
            return await self.wait(job.command.id, listener)
        ended = self.ended.last(symbol)
        if ended is None:
            text = f"no command {symbol} is running, and none has ended yet"
            raise StateError(f"{text}{self._forgotten()}", command=symbol)
        return _outcome(ended)

    def fired(self, firings: Sequence[Firing]) -> None:
        """Inform listeners of the steps of the commands."""
        if self._open:
            for firing in firings:
                if firing.phase is Phase.START and firing.command_id in self._open:
                    command = self._open[firing.command_id]
                    command.step = firing.transition
                    command.progress = max(command.progress, firing.progress)
                    self._tell(firing.command_id, firing.transition, "", firing.progress)

    def progressed(self, number: int, text: str, fraction: float) -> None:
        """Inform listeners of the progress of an action of the command."""
        if number in self._open:
            command = self._open[number]
            command.text, command.progress = text, max(command.progress, fraction)
        self._tell(number, "", text, fraction)

    def note_event(self, text: str) -> None:
        """Note an event, such as the restart of a task: a command under way may fail because of the event."""
        for number in self._open:
            events = self._events.setdefault(number, [])
            if text not in events and len(events) < MOST_EVENTS:
                events.append(text)

    def _tell(self, number: int, transition: str, text: str, fraction: float) -> None:
        for listener in self._listeners.get(number, ()):
            try:
                listener(transition, text, fraction)
            except FOREIGN as error:  # a listener is foreign code: the net goes on whatever it raises
                self._node.get_logger().error(f"a listener of command {number} broke: {error!r}")

    def _forgotten(self) -> str:
        return f": {self.lost}" if self.lost else ""

    def _closing(self, number: int, symbol: str) -> Callable[[CommandResult], None]:
        def closed(result: CommandResult) -> None:
            events = self._events.pop(number, [])
            ended = _ended(number, symbol, _explained(_tellable(symbol, result), events))
            if ended.success and number in self._open and self._open[number].job.cancelled:
                ended.message = NOT_OBEYED
            outcome = _outcome(ended)
            self.ended.add(ended)
            how = ": ".join(filter(None, ("done" if ended.success else "failed", ended.message)))
            self._node.get_logger().info(f"command {number}: {symbol} {how}")
            self._open.pop(number, None)
            self._listeners.pop(number, None)
            for promise in self._waiting.pop(number, []):
                if not promise.done():
                    promise.set_result(outcome)
            for executor in self._nets.values():
                for held in [each for each in executor.rule.held if each > 0 and each not in self._open]:
                    executor.post(CommandHeld(held, False))  # one that was ended while it was paused
            self._scopes.tidy()
            self._notes.changed()

        return closed


def _tellable(symbol: str, result: CommandResult) -> CommandResult:
    """Return a result fit for the client; a result beyond JSON is a failure."""
    try:
        results = plain_dict(result.results, f"what {symbol} returned")
    except NetError as unfit:
        return CommandResult(False, result.error or unfit, {})
    return CommandResult(result.success, result.error, results)


def _explained(result: CommandResult, events: Sequence[str]) -> CommandResult:
    """Return a result with the events before the failure of the command."""
    if result.error is None or result.error.code == "cancelled":
        return result
    untold = [event for event in events if event.partition(";")[0] not in result.error.message]
    if not untold:
        return result
    words = f"{result.error.message}; before that: {'; '.join(untold)}"
    error = ImError.restored(result.error.code, words, result.error.facts)
    return CommandResult(result.success, error, result.results)


def _ended(number: int, symbol: str, result: CommandResult) -> EndedCommand:
    status = ok_status() if result.error is None else to_status(result.error)
    facts = {fact.key: fact.value for fact in status.facts}
    why = {"code": status.code, "message": status.message, "facts": facts}
    return EndedCommand(
        number=number, symbol=symbol, time=wall(), success=result.success, results=result.results, **why
    )


def _outcome(ended: EndedCommand) -> CommandOutcome:
    facts = [KeyValue(key=key, value=value) for key, value in ended.facts.items()]
    return CommandOutcome(ended.success, Status(code=ended.code, message=ended.message, facts=facts), ended.results)
