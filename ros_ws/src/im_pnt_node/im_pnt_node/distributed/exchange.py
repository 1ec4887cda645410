"""The exchange of one process: carries tokens, requests and replies between the nets, and to and from others.

:class:`Exchange` has the requests that wait for their reply (:mod:`.requests`) and the inboxes of the nets
(:mod:`.inboxes`). It tells its journal what happens to them (:mod:`.entries`), before it is done.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError, LinkError, StateError, nearest
from im_pnt.errors import NetError
from im_pnt.execution.abandonment import abandonment
from im_pnt.execution.events import (
    ActionEnded,
    CommandHeld,
    JobUpdate,
    JobUpdateArrived,
    NodeForgotten,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.executor import Executor
from im_pnt.execution.firing.rule import ABANDONED_CODE
from im_pnt.execution.jobs import NO_COMMAND, Activity, Command, Job, JobKey, Owner, Request, TokenContext, scope_of
from im_pnt.execution.journal_entries import Record
from im_pnt.execution.notification import Departure, Observer
from im_pnt.execution.succession import rename
from im_pnt.model.action import RequestAction
from im_pnt.model.net import Net, RemotePlace
from im_pnt_node.distributed.entries import (
    EventPosted,
    ExchangeEntry,
    ReplyArrived,
    RequestAnswered,
    RequestAsked,
    RequestClosed,
    RequestsRenamed,
    TokenKept,
)
from im_pnt_node.distributed.inboxes import Inboxes
from im_pnt_node.distributed.packets import VOID, Message, began_at, token_message
from im_pnt_node.distributed.requests import RequestBook, Waiting

RETURN_TIMEOUT_S = 60.0
"""One that hangs is noticed, and started again, within half of it [s]."""


class Transport(Protocol):
    """Carrier of messages to other processes: a :class:`im_pnt_node.distributed.link.Link`, or a wrapper of one."""

    def node_of(self, net: str) -> str:
        """Return the node of a net."""

    def send(self, node: str, message: Message) -> None:
        """Send a message, to arrive once, some time, and in order.

        Raises:
            NetError: JSON cannot carry a part of it.
        """

    def forget(self, request_id: str) -> None:
        """Stop the repetition of messages about a request."""

    def keeps_journal(self, node: str) -> bool:
        """Return whether a node has announced a journal."""


class Exchange:
    """Nets of one process, and the requests under way.

    Args:
        node: Name of the process' node.
        epoch: Its incarnation.
        transport: To other processes; None: there are none.
        observer: Is told of what is dropped, and why.
        return_timeout_s: How long a dead process may take to come back before what waits for it fails, if both keep a
            journal [s].
        clock: Present time [s].

    Attributes:
        inboxes: Delivers to the nets of this process.
        nets: The nets, by name.
        book: Requests that wait for their reply.
        undeliverable: Tokens that no net wanted, by the place that they were sent to: they are kept here.
    """

    def __init__(
        self,
        node: str,
        epoch: int,
        transport: Transport | None = None,
        observer: Observer | None = None,
        *,
        return_timeout_s: float = RETURN_TIMEOUT_S,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.inboxes = Inboxes()
        self.nets = self.inboxes.nets
        self.book = RequestBook(node, epoch)
        self.undeliverable: Counter[RemotePlace] = Counter()
        self._node, self._transport = node, transport
        self._observer = observer or Observer()
        self._return_timeout_s, self._clock = return_timeout_s, clock
        self._lost: dict[str, tuple[float, str]] = {}

    def add(self, executor: Executor) -> None:
        """Enter a net, in the place of one of the same name if not busy.

        Raises:
            StateError: The one of the same name is busy.
        """
        name = executor.net.name
        if name in self.nets and self.nets[name].busy():
            raise StateError(
                f"net {name} is busy and cannot be replaced now; wait until its command has ended", net=name
            )
        self.nets[name] = executor

    def succeed(self, executor: Executor) -> None:
        """Enter a net in the place of the predecessor, with the state; take over replies to the predecessor."""
        name = executor.net.name
        waiting = [(each, asked) for each, asked in self.book.items() if asked.executor is self.nets[name]]
        self.nets[name] = executor
        for request_id, asked in waiting:
            self.book.close(request_id)
            self.watch(RequestAsked(request_id, name, asked.activity.number, asked.net, asked.node))

    def rename(self, executor: Executor, net: Net, record: Record | None) -> None:
        """Have a net go on under another name, beside the one that it had.

        Args:
            executor: The net; has taken all its events.
            net: The same as written, under the other name.
            record: Takes what happens to it from now on.
        """
        self._keep_names(executor)
        rename(executor, net, record)
        for job in executor.jobs():
            if job.request is not None and job.request.id in self.inboxes.in_work:
                self.inboxes.in_work[job.request.id] = replace(self.inboxes.in_work[job.request.id], net=net.name)
        self.nets[net.name] = executor

    def _keep_names(self, executor: Executor) -> None:
        """Let running actions keep the names that their goals have."""
        for activity in executor.activities:
            activity.begun_as = activity.begun_as or f"{self.book.incarnation}/{activity.net}"

    # What the nets of this process send.

    def send_token(self, net: str, target: RemotePlace, count: int, departure: Departure | None = None) -> None:
        """Send tokens to a place of another net; tokens of a job with the context."""
        message, context = token_message(target.net, target.place), None
        if departure is not None:
            context = self._carried(net, target.net, departure)
            message = Message(target.net, TokenArrived(target.place, 1, context))
        for _ in range(count):
            if target.net in self.nets:
                self._kept(message, self.inboxes.token(target.net, target.place, context))
            elif self._transport is not None and (node := self._node_of(target.net)):
                try:
                    self._transport.send(node, message)
                except NetError as error:
                    self._kept(message, error.message)
            else:
                self._kept(message, f"there is no net {target.net}{nearest(target.net, self.nets)}")

    def _carried(self, net: str, target: str, departure: Departure) -> TokenContext:
        job, failure, results, held = departure
        if job.visit is not None:
            owner = job.visit.owner
        else:
            symbol = job.symbol if job.from_tape else ""
            owner = Owner(self._key_of(net, job), symbol, job.command, job.arguments)
        cancelled = (job.last_failure or cancelled_by(net)) if job.cancelled else None
        return TokenContext(owner, self._is_home(owner.key, target), "", net, failure, results, cancelled, held)

    def _node_of(self, net: str) -> str:
        """The node of a net of another process; empty where the net is here, or is known to be nowhere else."""
        if net in self.nets or self._transport is None:
            return ""
        node = self._transport.node_of(net)
        return "" if node == self._node else node

    def _key_of(self, net: str, job: Job) -> JobKey:
        return JobKey(self.book.prefix, net, job.number) if job.visit is None else job.visit.owner.key

    def _is_home(self, key: JobKey, net: str) -> bool:
        return key.process == self.book.prefix and key.net == net

    def send_job_update(
        self, net: str, job: Job, update: JobUpdate, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Inform another net of a job with tokens there."""
        told = JobUpdateArrived(self._key_of(net, job), False, update, net, error, results)
        self._send_tiding(self._node_of(to), to, told)

    def send_settled(
        self, net: str, key: JobKey, node: str, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Inform the sender of a job's token: the work for the token is done."""
        self._send_tiding(node, to, JobUpdateArrived(key, False, JobUpdate.SETTLED, net, error, results))

    def _send_tiding(self, node: str, to: str, told: JobUpdateArrived) -> None:
        if node and self._transport is not None:
            self._transport.send(node, Message(to, told))
        elif to in self.nets:
            self.inboxes.post(self.nets[to], replace(told, home=self._is_home(told.key, to)))

    def send_request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Send a request; the reply, or the cause of a missing one, ends the activity."""
        action = activity.action
        assert isinstance(action, RequestAction)
        local = action.net in self.nets
        node = self._node_of(action.net)
        request_id = self.book.next_name()
        job = activity.lineage.job
        command = job.command if job else Command(scope=scope_of(activity.net, NO_COMMAND))
        request = Request(
            request_id, action.net, action.service, "", activity.net, activity.transition, command, arguments
        )
        held = self.nets[activity.net].rule.is_paused(activity)
        self._happens(RequestAsked(request_id, activity.net, activity.number, action.net, node))
        try:
            if local:
                refusal = self.inboxes.request(request, held)
                if refusal:
                    self._answer(request_id, NetError(refusal), {})
            elif self._transport is None or not node:
                error = LinkError(f"there is no net {action.net}{nearest(action.net, self.nets)}")
                self._answer(request_id, error, {})
            else:
                self._transport.send(node, Message(action.net, RequestArrived(request, held)))
        except NetError as error:
            self._answer(request_id, error, {})

    def awaits_reply(self, activity: Activity) -> bool:
        """Return whether the request of an activity still awaits the reply."""
        return self.book.of_activity(activity) is not None

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answer a request of any process."""
        self.inboxes.close(request)
        try:
            self._send_reply(request, error, results)
        except NetError as wrong:
            self._send_reply(request, wrong, {})

    def _send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        if not request.caller_node:
            if not self._answer(request.id, error, results) and not _is_abandoned(error):
                waiter = f"{request.caller_net}.{request.caller_transition}"
                self._dropped(f"nobody waits for the reply to {waiter} any more")
        elif self._transport is not None:
            message = Message(request.caller_net, ReplyArrived(request.id, error, results))
            self._transport.send(request.caller_node, message)

    def _cancel_request(self, activity: Activity, why: ImError) -> None:
        found = self.book.of_activity(activity)
        if found is None:
            return
        request_id, waiting = found
        if request_id in self.inboxes.in_work:
            self.inboxes.cancel(self.inboxes.in_work[request_id], why)
        elif self._transport is not None:
            self._transport.send(waiting.node, Message(waiting.net, RequestCancelled(request_id, why)))
        if why.code == ABANDONED_CODE:
            self._happens(RequestAnswered(request_id))

    def _release_request(self, activity: Activity) -> None:
        found = self.book.of_activity(activity)
        if found is None:
            return
        request_id, waiting = found
        if request_id in self.inboxes.in_work:
            self.inboxes.hold(request_id, False)
        elif self._transport is not None:
            self._transport.send(waiting.node, Message(waiting.net, RequestHeld(request_id, False)))

    def hold_all(self, held: bool) -> None:
        """Have nothing begun for any job of the nets and any arrived work; or have everything go on."""
        for executor in self.nets.values():
            self.inboxes.post(executor, CommandHeld(None, held))

    # What arrives from other processes.

    def receive(self, sender: str, message: Message) -> str:
        """Take in a message from another process; return the reason of a refusal, empty without one."""
        try:
            return self._receive(sender, message)
        except NetError as error:  # a journal cannot keep what it carries
            return error.message

    def _receive(self, sender: str, message: Message) -> str:
        net, event = message
        if event is None:
            return ""
        if isinstance(event, ReplyArrived):
            self._take_reply(sender, event)
            return ""
        if net not in self.nets:
            return f"there is no net {net} here{nearest(net, self.nets)}"
        match event:
            case TokenArrived(place, _, context):
                if context is not None:
                    context = replace(context, node=sender, home=self._is_home(context.owner.key, net))
                return self.inboxes.token(net, place, context)
            case JobUpdateArrived(error=error):
                visit = self.nets[net].rule.ledger.visits.get(event.key)
                if visit is not None and error is not None:
                    error = self._told(error, visit.command)
                self.inboxes.post(self.nets[net], replace(event, home=self._is_home(event.key, net), error=error))
            case RequestArrived(request, held):
                if request.id in self.inboxes.in_work:
                    return f"request {request.id} is in work already"
                return self.inboxes.request(replace(request, net=net, caller_node=sender), held)
            case RequestCancelled(request_id, error):
                if self._asked_by(sender, request_id):
                    request = self.inboxes.in_work[request_id]
                    self.inboxes.cancel(request, self._told(error, request.command))
            case RequestHeld(request_id, held):
                if self._asked_by(sender, request_id):
                    self.inboxes.hold(request_id, held)
        return ""

    def _told(self, error: ImError, command: Command) -> ImError:
        """Return the error of an early end; for journal and log, that of an abandoned command has what is held here."""
        if not _is_abandoned(error):
            return error
        error = abandonment(self.nets.values(), command, error.message)
        self._dropped(f"command {command.symbol} is {error.message}")
        return error

    def _asked_by(self, sender: str, request_id: str) -> bool:
        """Whether a request is in work, and is that of a process."""
        return request_id in self.inboxes.in_work and self.inboxes.in_work[request_id].caller_node == sender

    def _take_reply(self, sender: str, reply: ReplyArrived) -> None:
        try:
            found = self._answer(*reply)
        except NetError as unfit:
            found = self._answer(reply.request_id, unfit, {})
        if not found and not _is_abandoned(reply.error):
            self._dropped(f"nobody waits for reply {reply.request_id} of {sender} any more")

    def refused(self, message: Message, why: str) -> None:
        """Take back a refused message; a token is kept as undeliverable."""
        asks = isinstance(message.event, RequestArrived | RequestCancelled | RequestHeld)
        if isinstance(message.event, TokenArrived):
            self._kept(message, why)
        elif not asks or not self._answer(message.request_id, NetError(why), {}):
            self._dropped(f"{message} was refused: {why}")

    # Processes that die and return.

    def node_lost(self, node: str, why: str) -> None:
        """Note the loss of a node: with journals on both sides, allow time to return; else fail the requests now."""
        if node in self._lost:
            return
        transport = self._transport
        if self.inboxes.record is None or transport is None or not transport.keeps_journal(node):
            self._give_up(node, why)
            return
        self._lost[node] = (self._clock() + self._return_timeout_s, why)
        self._dropped(f"{why}; it has {self._return_timeout_s:g} s to return")
        transport.send(node, VOID)  # it is repeated until the node acknowledges it, which shows that it is back

    def node_returned(self, node: str) -> None:
        """Note a heartbeat of a node."""
        self._lost.pop(node, None)

    def node_reset(self, node: str, why: str, in_flight: list[Message]) -> None:
        """Give up mutual requests with a node of different memory.

        Args:
            node: The other node.
            why: One has come back without its journal, or with an old one.
            in_flight: Messages to it that were not acknowledged.
        """
        counts = Counter(str(message) for message in in_flight)
        listed = ", ".join(f"{count} x {text}" for text, count in counts.items()) or "nothing"
        why = f"{why}; in flight were: {listed}"
        self._dropped(why)
        self._lost.pop(node, None)
        self._give_up(node, why)

    def begin_incarnation(self, epoch: int) -> None:
        """Begin an incarnation after a loss of memory: no later request has the name of a forgotten one."""
        self._happens(RequestsRenamed(f"{self._node}-{began_at(epoch):x}"))

    def _give_up(self, node: str, why: str) -> None:
        for name, executor in self.nets.items():
            nets = self._nets_of(node, executor)
            if executor.concerned(node, nets):
                self.inboxes.post(self.nets[name], NodeForgotten(node, nets, LinkError(why, node=node)))
        for request_id, waiting in self.book.of_node(node):
            if self._transport is not None:
                self._transport.forget(request_id)
                unwanted = RequestCancelled(request_id, cancelled_by(waiting.activity.net))
                self._transport.send(node, Message(waiting.net, unwanted))
            self._answer(request_id, LinkError(why, node=node), {})
        for request in list(self.inboxes.in_work.values()):
            if request.caller_node == node:
                self.inboxes.close(request)
                self.inboxes.cancel(request, LinkError(why, node=node))

    def _nets_of(self, node: str, executor: Executor) -> tuple[str, ...]:
        """Return the nets of a node with tokens from a net."""
        given = {target.net for each in executor.net.transitions.values() for target in each.remote_outputs}
        return tuple(sorted(net for net in given if self._node_of(net) == node))

    def partners(self) -> frozenset[str]:
        """Return the nodes with open requests, with owed replies, and with tokens of jobs."""
        asked = {waiting.node for _, waiting in self.book.items() if waiting.node}
        for executor in self.nets.values():
            for job in executor.jobs():
                asked |= {job.visit.node} if job.visit is not None and job.visit.node else set()
                asked |= {node for net in job.away if (node := self._node_of(net))}
        return frozenset(asked | {r.caller_node for r in self.inboxes.in_work.values() if r.caller_node})

    def tidy(self) -> None:
        """Give up nodes not returned in time, and drop requests without a waiting transition."""
        now = self._clock()
        for node, (deadline, why) in list(self._lost.items()):
            if now >= deadline:
                del self._lost[node]
                self._give_up(node, f"{why}; it has not returned in {self._return_timeout_s:g} s")
        for request_id, waiting in self.book.given_up():
            self._happens(RequestAnswered(request_id))
            self._dropped(f"net {waiting.net} has not answered request {request_id} in time")

    # Requests that wait, and tokens that nobody wants.

    def watch(self, asked: RequestAsked) -> None:
        """Enter a request, to cancel together with the activity.

        Raises:
            NetError: The activity does not run.
            LookupError: The net is not there.
        """
        executor = self.nets[asked.net]
        activity = executor.activity(asked.number)
        self.book.open(asked.request_id, Waiting(executor, activity, asked.asked, asked.node))
        activity.on_cancel.append(lambda: self._cancel_request(activity, cancelled_by(activity.net)))
        activity.on_abandon.append(lambda error: self._cancel_request(activity, error))
        activity.on_release.append(lambda: self._release_request(activity))

    def _answer(self, request_id: str, error: ImError | None, results: dict[str, object]) -> bool:
        """End a request with the reply; return whether an activity waited for the reply."""
        waiting = self.book.get(request_id)
        if waiting is None:
            return False
        self.inboxes.post(waiting.executor, ActionEnded(waiting.activity, error, results))
        self._happens(RequestAnswered(request_id))
        return True

    def _kept(self, message: Message, why: str) -> None:
        """Keep an undeliverable token, visible and counted."""
        if why and isinstance(message.event, TokenArrived):
            self._happens(TokenKept(message.net, message.event.place))
            self._dropped(f"{message} is undeliverable and kept: {why}")
            context = message.event.context
            if context is not None:
                self.send_settled(message.net, context.owner.key, "", context.net, NetError(why), {})

    # What happens to the exchange, now and when a journal is replayed.

    def _happens(self, entry: ExchangeEntry) -> None:
        if self.inboxes.record is not None:
            self.inboxes.record(entry)
        self.replay(entry)

    def replay(self, entry: ExchangeEntry) -> None:
        """Apply an entry; nothing is posted or sent.

        Raises:
            NetError: It speaks of an activity that does not run.
            LookupError: It speaks of a net or a request that is not there.
        """
        match entry:
            case EventPosted(net, event):
                self.inboxes.deliveries.put_delivery(net, event)
                if isinstance(event, RequestArrived):
                    self.inboxes.in_work[event.request.id] = event.request
            case RequestAsked():
                self.book.count += 1
                self.watch(entry)
            case RequestAnswered(request_id):
                self.book.close(request_id)
            case RequestClosed(request_id):
                del self.inboxes.in_work[request_id]
            case RequestsRenamed(incarnation):
                for executor in self.nets.values():
                    self._keep_names(executor)
                self.book.incarnation = incarnation
            case TokenKept(net, place):
                self.undeliverable[RemotePlace(net, place)] += 1

    def _dropped(self, why: str) -> None:
        self._observer.troubled("", why)


def _is_abandoned(error: ImError | None) -> bool:
    return error is not None and error.code == ABANDONED_CODE


def cancelled_by(net: str) -> ImError:
    """Return the reason of an early end by the caller's cancellation."""
    return ImError(f"cancelled by net {net}", code="cancelled", net=net)
