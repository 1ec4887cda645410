"""A process without ROS that keeps a journal: a test kills it, and brings it back from its files."""

from collections.abc import Callable, Mapping, Sequence

from im_core.errors import StateError
from im_core.store_mark import SeenStore
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import Functions, GuardFunction
from im_pnt.execution.notification import Observer
from im_pnt.execution.runner import FunctionRunner, Perform
from im_pnt.model.net import Net
from im_pnt_node.distributed.exchange import RETURN_TIMEOUT_S, Exchange
from im_pnt_node.distributed.link import Link
from im_pnt_node.distributed.packets import Message
from im_pnt_node.journal.folder import Files
from im_pnt_node.journal.journal import COMPACT_BYTES, Journal
from im_pnt_node.journal.log import Sync
from support.process import drive


class JournalledProcess:
    """Nets of one process with their journal, from the moment in which it is started or comes back.

    Args:
        name: Name of the process.
        nets: Its nets.
        files: Where its journal is.
        actions: Registered functions.
        guards: Enabling functions.
        nodes: Processes of the nets of others, by net; a process that is not listed has the name of its net.
        transmit: Sends a packet to a process.
        clock: Present time [s].
        observer: Is told of what happens.
        compact_bytes: Size of the journal above which a new file is begun [bytes].
        sync: When a record counts as written.
        others: What carries out actions of further kinds.
        run: Name of the run of the machine; what comes back from another one is paused.
        resumes: What comes back from another run goes on instead.
    """

    def __init__(
        self,
        name: str,
        nets: Sequence[Net],
        files: Files,
        *,
        actions: Mapping[str, Callable[..., object]] | None = None,
        guards: Mapping[str, GuardFunction] | None = None,
        nodes: Mapping[str, str] | None = None,
        transmit: Callable[[str, str], None] = lambda node, packet: None,
        clock: Callable[[], float] = lambda: 0.0,
        observer: Observer | None = None,
        compact_bytes: int = COMPACT_BYTES,
        sync: Sync = Sync.OS,
        others: Mapping[type, Perform] | None = None,
        return_timeout_s: float = RETURN_TIMEOUT_S,
        run: str = "",
        resumes: bool = False,
        store: SeenStore | None = None,
    ) -> None:
        observer = observer or Observer()
        self._nodes = dict(nodes or {})
        self.journal = Journal(
            files, name, sync=sync, compact_bytes=compact_bytes, observer=observer, run=run, store=store
        )
        self.link = Link(
            name,
            self.journal.epoch,
            lambda sender, message: self.exchange.receive(sender, message),
            lambda message, why: self.exchange.refused(message, why),
            lambda node, why, in_flight: self.exchange.node_reset(node, why, in_flight),
            lambda node: self.exchange.node_returned(node),
            transmit,
            observer,
            clock,
        )
        self.exchange = Exchange(
            name, self.journal.epoch, self, observer, return_timeout_s=return_timeout_s, clock=clock
        )
        functions = Functions(actions, guards)
        runner = self.journal.guard(FunctionRunner(functions, self.exchange, drive, others))
        for net in nets:
            record = self.journal.recorder(net.name)
            self.exchange.add(Executor(net, functions, runner, self.exchange, observer, clock=clock, record=record))
        held = None if self.journal.of_this_run else not resumes
        self.recovered = self.journal.start(self.exchange, self.link, held)

    def node_of(self, net: str) -> str:
        """Returns the process that runs a net."""
        return self._nodes.get(net, net)

    def send(self, node: str, message: Message) -> None:
        """Sends a message."""
        self.link.send(node, message)

    def forget(self, request_id: str) -> None:
        """Stops repeating what was sent about a request."""
        self.link.forget(request_id)

    def keeps_journal(self, node: str) -> bool:
        """Whether a process has said that it keeps a journal."""
        return self.link.keeps_journal(node)

    def turn(self, rounds: int = 1000) -> None:
        """Fires until nothing happens, and lets messages go when the journal has been written.

        Raises:
            StateError: The nets do not come to rest.
        """
        executors = list(self.exchange.nets.values())
        for _ in range(rounds):
            for executor in executors:
                executor.pump()
            if not any(executor.due for executor in executors):
                self.journal.commit()
                return
        raise StateError(f"the nets do not come to rest in {rounds} rounds")

    def tick(self) -> None:
        """Does what time demands: gives up those that do not return, sends again, acknowledges."""
        self.exchange.tidy()
        self.turn()
        self.link.tick()
