"""The commands of a node's nets: who waits for them, who is told of them, and how the last ones ended."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from im_core.errors import NotFoundError, StateError
from im_core.ros.coroutines import Promise
from im_core.ros.node import ManagedNode
from im_core.ros.status import ok_status, to_status
from im_msgs.msg import Status
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Command, CommandResult, Job
from im_pnt.execution.notification import Firing, Phase

ProgressListener = Callable[[str, str, float], None]
"""Is told the transition that fired or reported, a text, and the progress 0..1 (negative: unknown)."""


@dataclass(frozen=True)
class CommandOutcome:
    """How a command ended, as its client is told."""

    success: bool
    status: Status
    results: dict[str, object]


class Commands:
    """Writes commands to the input tapes of a node's nets and knows those that have not ended.

    Args:
        node: The node.
        nets: Its nets by name; looked at anew for each command.
    """

    def __init__(self, node: ManagedNode, nets: Mapping[str, Executor]) -> None:
        self._node, self._nets = node, nets
        self._count = 0
        self._open: dict[int, Job] = {}
        self._ended: dict[str, CommandOutcome] = {}
        self._waiting: dict[int, list[Promise]] = {}
        self._listeners: dict[int, list[ProgressListener]] = {}

    def symbols(self) -> list[str]:
        """Returns the symbols that the nets read from their tapes."""
        return sorted({symbol for executor in self._nets.values() for symbol in executor.net.symbols()})

    def running(self, symbol: str) -> Job | None:
        """Returns the oldest command of a symbol that has not ended, if any."""
        return next((job for job in self._open.values() if job.command.symbol == symbol), None)

    def take_up(self) -> None:
        """Enters the commands that nets have brought back from a journal."""
        for executor in self._nets.values():
            for job in executor.jobs():
                if job.request is None:
                    self._open[job.command.id] = job
                    job.on_closed = self._closing(job.command.id, job.command.symbol)
        self._count = max(self._open, default=0)

    def write(self, symbol: str, arguments: Mapping[str, object]) -> int:
        """Writes a command to the tape of the net that reads its symbol; returns its number.

        Raises:
            NotFoundError: No net knows the symbol.
        """
        for executor in self._nets.values():
            if symbol in executor.net.symbols():
                break
        else:
            raise NotFoundError(kind="command", name=symbol, known=self.symbols())
        self._count += 1
        number = self._count
        command = Command(number, symbol, dict(arguments))
        self._open[number] = executor.command(command, self._closing(number, symbol))
        return number

    async def wait(self, number: int, listener: ProgressListener | None = None) -> CommandOutcome:
        """Waits until a command has ended.

        Args:
            number: Its number.
            listener: Is told of progress.
        """
        promise = self._node.promise()
        self._waiting.setdefault(number, []).append(promise)
        if listener is not None:
            self._listeners.setdefault(number, []).append(listener)
        outcome: CommandOutcome = await promise
        return outcome

    async def attach(
        self, symbol: str, listener: ProgressListener | None = None, started: Callable[[int], None] | None = None
    ) -> CommandOutcome:
        """Waits for the running command of a symbol, or returns how the last one ended.

        Args:
            symbol: Symbol of the command.
            listener: Is told of progress.
            started: Is told the number of the running command.

        Raises:
            StateError: None is running, and none has ended since the node began.
        """
        job = self.running(symbol)
        if job is not None:
            if started is not None:
                started(job.command.id)
            return await self.wait(job.command.id, listener)
        if symbol not in self._ended:
            raise StateError(f"no command {symbol} is running, and none has ended yet", command=symbol)
        return self._ended[symbol]

    def fired(self, firings: Sequence[Firing]) -> None:
        """Tells listeners of the steps of their commands."""
        if self._listeners:
            for firing in firings:
                if firing.phase is Phase.START:
                    for listener in self._listeners.get(firing.command_id, ()):
                        listener(firing.transition, "", firing.progress)

    def progressed(self, number: int, text: str, fraction: float) -> None:
        """Tells listeners what an action of their command has reported."""
        for listener in self._listeners.get(number, ()):
            listener("", text, fraction)

    def _closing(self, number: int, symbol: str) -> Callable[[CommandResult], None]:
        def closed(result: CommandResult) -> None:
            status = ok_status() if result.error is None else to_status(result.error)
            outcome = self._ended[symbol] = CommandOutcome(result.success, status, result.results)
            self._open.pop(number, None)
            self._listeners.pop(number, None)
            for promise in self._waiting.pop(number, []):
                if not promise.done():
                    promise.set_result(outcome)

        return closed
