"""The exchange of one process: carries tokens, requests and replies between its nets, and to and from others."""

from collections import Counter
from collections.abc import Callable
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError, LinkError, StateError
from im_pnt.action import RequestAction
from im_pnt.errors import NetError, nearest
from im_pnt.events import ActionEnded, Observer
from im_pnt.executive import Executive
from im_pnt.inboxes import Inboxes
from im_pnt.jobs import Activity, Command, Request
from im_pnt.net import RemotePlace
from im_pnt.record import Entry
from im_pnt.remote import VOID, Kind, Message, token_message
from im_pnt.requests import RequestBook, Waiting, cancel_message, cancelled_by, request_message, request_of

RETURN_TIMEOUT_S = 30.0
_TOKEN = Kind.TOKEN


class Transport(Protocol):
    """Carries messages to other processes: a :class:`im_pnt.link.Link`, or what stands before one."""

    def node_of(self, net: str) -> str:
        """Returns the node that runs a net."""

    def send(self, node: str, message: Message) -> None:
        """Sends a message; it arrives once, some time, and in order.

        Raises:
            NetError: Its payload is not JSON data.
        """

    def forget(self, request_id: str) -> None:
        """Stops repeating what was sent about a request."""

    def keeps_journal(self, node: str) -> bool:
        """Whether a node has said that it keeps a journal."""


class Exchange:
    """Knows the nets of its process, and the requests under way.

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
        muted: Nets that are brought back repeat what they sent; it is not sent again.
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
        self.muted = False
        self._transport = transport
        self._observer = observer or Observer()
        self._return_timeout_s, self._clock = return_timeout_s, clock
        self._lost: dict[str, tuple[float, str]] = {}

    def add(self, executive: Executive) -> None:
        """Enters a net, in the place of one of the same name that is not busy.

        Raises:
            StateError: The one of the same name is busy.
        """
        name = executive.net.name
        if name in self.nets and self.nets[name].busy():
            raise StateError(
                f"net {name} is busy and cannot be replaced now; wait until its command has ended", net=name
            )
        self.nets[name] = executive

    # What the nets of this process send.

    def send_token(self, net: str, target: RemotePlace, count: int) -> None:
        """Sends tokens to a place of another net."""
        if self.muted:
            return
        message = token_message(target.net, target.place)
        for _ in range(count):
            if target.net in self.nets:
                self._kept(message, self.inboxes.token(target.net, target.place))
            elif self._transport is not None:
                self._transport.send(self._transport.node_of(target.net), message)
            else:
                self._kept(message, f"there is no net {target.net}{nearest(target.net, self.nets)}")

    def send_request(self, executive: Executive, activity: Activity, arguments: dict[str, object]) -> None:
        """Sends a request; its reply, or why there is none, ends the activity."""
        action = activity.action
        assert isinstance(action, RequestAction)
        local = action.net in self.nets
        node = "" if local or self._transport is None else self._transport.node_of(action.net)
        request_id = self.book.next_name()
        job = activity.lineage.job
        command = job.command if job else Command()
        request = Request(
            request_id, action.net, action.service, "", activity.net, activity.transition, command, arguments
        )
        self._note(["asked", request_id, activity.net, activity.number, action.net, node])
        self.watch(request_id, Waiting(executive, activity, action.net, node))
        try:
            if local:
                refusal = self.inboxes.request(request)
                if refusal:
                    self._answer(request_id, NetError(refusal), {})
            elif self._transport is None:
                error = LinkError(f"there is no net {action.net}{nearest(action.net, self.nets)}")
                self._answer(request_id, error, {})
            else:
                self._transport.send(node, request_message(request))
        except NetError as error:
            self._answer(request_id, error, {})

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request of whatever process."""
        if self.muted:
            return
        self.inboxes.close(request)
        try:
            self._send_reply(request, error, results)
        except NetError as wrong:
            self._send_reply(request, wrong, {})

    def _send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        if not request.caller_node:
            if not self._answer(request.id, error, results):
                waiter = f"{request.caller_net}.{request.caller_transition}"
                self._dropped(f"nobody waits for the reply to {waiter} any more")
        elif self._transport is not None:
            message = Message(Kind.REPLY, request.caller_net, "", request.id, error=error, payload={"results": results})
            self._transport.send(request.caller_node, message)

    def _cancel_request(self, activity: Activity) -> None:
        found = self.book.of_activity(activity)
        if found is None or self.muted:
            return
        request_id, waiting = found
        if request_id in self.inboxes.in_work:
            self.inboxes.cancel(self.inboxes.in_work[request_id], cancelled_by(activity.net))
        elif self._transport is not None:
            self._transport.send(waiting.node, cancel_message(request_id, waiting.net, activity.net))

    # What arrives from other processes.

    def receive(self, sender: str, message: Message) -> str:
        """Takes a message from another process; returns why it is refused, empty if it is not."""
        kind = message.kind
        if kind is _TOKEN and message.net in self.nets:
            return self.inboxes.token(message.net, message.place)
        if kind is Kind.VOID:
            return ""
        if kind is Kind.REPLY:
            results = message.payload.get("results")
            if not self._answer(message.request_id, message.error, results if isinstance(results, dict) else {}):
                self._dropped(f"nobody waits for reply {message.request_id} of {sender} any more")
            return ""
        if message.net not in self.nets:
            return f"there is no net {message.net} here{nearest(message.net, self.nets)}"
        if message.payload.get("cancel") is True:
            request = self.inboxes.in_work.get(message.request_id)
            if request is not None and request.caller_node == sender:
                self.inboxes.cancel(request, cancelled_by(message.caller_net))
            return ""
        if message.request_id in self.inboxes.in_work:
            return f"request {message.request_id} is in work already"
        return self.inboxes.request(request_of(sender, message))

    def refused(self, message: Message, why: str) -> None:
        """Takes back a message that its receiver refused; a token is kept as undeliverable."""
        if message.kind is Kind.TOKEN:
            self._kept(message, why)
        elif message.kind is not Kind.REQUEST or not self._answer(message.request_id, NetError(why), {}):
            self._dropped(f"{message} was refused: {why}")

    # Processes that die and return.

    def node_lost(self, node: str, why: str) -> None:
        """A node is gone. If both keep a journal it is given time to return; otherwise what waits for it fails now."""
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
        """A node has given a sign of life."""
        self._lost.pop(node, None)

    def node_reset(self, node: str, in_flight: list[Message]) -> None:
        """A node has come back without its journal: what it was asked, and what it asked, is not known to it."""
        counts = Counter(str(message) for message in in_flight)
        listed = ", ".join(f"{count} x {text}" for text, count in counts.items()) or "nothing"
        why = f"{node} came back without its journal; in flight were: {listed}"
        self._dropped(why)
        self._lost.pop(node, None)
        self._give_up(node, why)

    def _give_up(self, node: str, why: str) -> None:
        for request_id, waiting in self.book.of_node(node):
            if self._transport is not None:
                self._transport.forget(request_id)
                self._transport.send(node, cancel_message(request_id, waiting.net, waiting.activity.net))
            self._answer(request_id, LinkError(why, node=node), {})
        for request in list(self.inboxes.in_work.values()):
            if request.caller_node == node:
                self.inboxes.close(request)
                self.inboxes.cancel(request, LinkError(why, node=node))

    def partners(self) -> frozenset[str]:
        """Returns the nodes that requests wait for, and those that wait for replies."""
        asked = {waiting.node for _, waiting in self.book.items() if waiting.node}
        return frozenset(asked | {r.caller_node for r in self.inboxes.in_work.values() if r.caller_node})

    def tidy(self) -> None:
        """Gives up nodes that have not returned in time, and drops requests whose transitions wait no more."""
        now = self._clock()
        for node, (deadline, why) in list(self._lost.items()):
            if now >= deadline:
                del self._lost[node]
                self._give_up(node, f"{why}; it has not returned in {self._return_timeout_s:g} s")
        for request_id, waiting in self.book.given_up():
            self.book.close(request_id)
            self._note(["answered", request_id])
            self._dropped(f"net {waiting.net} has not answered request {request_id} in time")

    # Requests that wait, and tokens that nobody wants.

    def watch(self, request_id: str, waiting: Waiting) -> None:
        """Enters a request, and has it cancelled when its activity is."""
        self.book.open(request_id, waiting)
        waiting.activity.on_cancel.append(lambda: self._cancel_request(waiting.activity))

    def _answer(self, request_id: str, error: ImError | None, results: dict[str, object]) -> bool:
        """Ends a request with its reply; returns whether anybody waited for it."""
        waiting = self.book.get(request_id)
        if waiting is None:
            return False
        self.inboxes.post(waiting.executive, ActionEnded(waiting.activity, error, results))
        self.book.close(request_id)
        self._note(["answered", request_id])
        return True

    def _kept(self, message: Message, why: str) -> None:
        """Keeps a token that nobody wants, where it is seen and counted."""
        if why:
            self.undeliverable[RemotePlace(message.net, message.place)] += 1
            self._note(["undeliverable", message.net, message.place])
            self._dropped(f"{message} is undeliverable and kept: {why}")

    def _note(self, entry: Entry) -> None:
        if self.inboxes.record is not None:
            self.inboxes.record(entry)

    def _dropped(self, why: str) -> None:
        self._observer.troubled("", why)
