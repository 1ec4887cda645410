"""The exchange of one process: carries tokens, requests and replies between its nets, and to and from others.

It has three parts: the requests that wait for their reply (:class:`RequestBook`), the inboxes of the nets
(:class:`Inboxes`), which keep for the journal what was delivered and not taken yet (:class:`Deliveries`), and
:class:`Exchange` itself. It tells its journal what happens to them as one of :data:`ExchangeEntry`, before it is done.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from im_core.clock import monotonic
from im_core.errors import DataError, ImError, LinkError, StateError, nearest
from im_pnt.distributed.packets import VOID, Message, MessageKind, token_message
from im_pnt.errors import NetError, decode_error, encode_error
from im_pnt.execution.events import (
    ActionEnded,
    NodeForgotten,
    RequestArrived,
    RequestCancelled,
    Tiding,
    TidingArrived,
    TokenArrived,
)
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import NO_COMMAND, Activity, Carried, Command, Job, JobKey, Owner, Request, scope_of
from im_pnt.execution.notification import Leaving, Observer
from im_pnt.execution.record import ActivityEnded, NetEntry, plain_dict
from im_pnt.model.action import RequestAction
from im_pnt.model.expand import input_place
from im_pnt.model.net import RemotePlace

RETURN_TIMEOUT_S = 60.0
"""One that hangs is noticed, and started again, within half of it [s]."""


# What an exchange tells its journal.

Arrival = TokenArrived | TidingArrived | NodeForgotten | RequestArrived | RequestCancelled
Delivery = Arrival | ActivityEnded
"""An event for a net, as the net that takes it records it: so it is known when it was."""


class EventPosted(NamedTuple):
    """An event was put into the inbox of a net."""

    net: str
    event: Delivery


class RequestAsked(NamedTuple):
    """A net has asked another one.

    Attributes:
        request_id: Name of the request.
        net: Net that asks.
        number: Number of its activity that waits.
        asked: Net that is asked.
        node: Node of that net, empty for one of the same process.
    """

    request_id: str
    net: str
    number: int
    asked: str
    node: str


class RequestAnswered(NamedTuple):
    """A request waits for its reply no more."""

    request_id: str


class RequestClosed(NamedTuple):
    """A request is not in work any more."""

    request_id: str


class TokenKept(NamedTuple):
    """A token is kept that no net wants."""

    net: str
    place: str


ExchangeEntry = EventPosted | RequestAsked | RequestAnswered | RequestClosed | TokenKept


# Requests under way.


@dataclass(frozen=True, slots=True)
class Waiting:
    """A request that waits for its reply.

    Attributes:
        executor: Net that asked.
        activity: Its transition in work.
        net: Net that was asked.
        node: Node of that net, empty for one of the same process.
    """

    executor: Executor
    activity: Activity
    net: str
    node: str


class RequestBook:
    """The requests that the nets of one process have asked and not yet got answered.

    Args:
        node: Name of the process' node, part of every request's name.
        epoch: Its incarnation, likewise.

    Attributes:
        prefix: Begins every request's name.
        count: Requests asked so far.
    """

    def __init__(self, node: str, epoch: int) -> None:
        self.prefix = f"{node}-{epoch:x}"
        self.count = 0
        self._waiting: dict[str, Waiting] = {}
        self._name: dict[Activity, str] = {}

    def next_name(self) -> str:
        """Returns the name of the next request, unique over all processes and their restarts."""
        return f"{self.prefix}-{self.count + 1}"

    def open(self, request_id: str, waiting: Waiting) -> None:
        """Enters a request."""
        self._waiting[request_id] = waiting
        self._name[waiting.activity] = request_id

    def close(self, request_id: str) -> None:
        """Takes a request out; a second reply, or one that comes too late, finds none."""
        waiting = self._waiting.pop(request_id, None)
        if waiting is not None:
            del self._name[waiting.activity]

    def of_activity(self, activity: Activity) -> tuple[str, Waiting] | None:
        """Returns the request of an activity, if it still waits."""
        name = self._name.get(activity)
        return None if name is None else (name, self._waiting[name])

    def get(self, request_id: str) -> Waiting | None:
        """Returns who waits for the reply to a request."""
        return self._waiting.get(request_id)

    def of_node(self, node: str) -> list[tuple[str, Waiting]]:
        """Returns the requests that wait for a node."""
        return [(name, waiting) for name, waiting in self._waiting.items() if waiting.node == node]

    def given_up(self) -> list[tuple[str, Waiting]]:
        """Returns the requests whose transition does not wait any more (its time was over)."""
        return [(name, w) for name, w in self._waiting.items() if w.activity not in w.executor.activities]

    def items(self) -> list[tuple[str, Waiting]]:
        """Returns all requests that wait."""
        return list(self._waiting.items())


def request_message(request: Request) -> Message:
    """Returns the message that carries a request to another process."""
    payload: dict[str, object] = {
        "arguments": request.arguments,
        "symbol": request.command.symbol,
        "command_arguments": request.command.arguments,
    }
    if request.command.scope:
        payload["scope"] = request.command.scope
    return Message(
        MessageKind.REQUEST,
        request.net,
        input_place(request.service),
        request.id,
        request.caller_net,
        request.caller_transition,
        request.command.id,
        payload=payload,
    )


def request_of(sender: str, message: Message) -> Request:
    """Returns the request that a message carries."""

    def mapping(key: str) -> dict[str, object]:
        value = message.payload.get(key)
        return value if isinstance(value, dict) else {}

    def text(key: str) -> str:
        value = message.payload.get(key)
        return value if isinstance(value, str) else ""

    command = Command(message.command_id, text("symbol"), mapping("command_arguments"), scope=text("scope"))
    return Request(
        message.request_id,
        message.net,
        message.place.removeprefix("I."),
        sender,
        message.caller_net,
        message.caller_transition,
        command,
        mapping("arguments"),
    )


def cancel_message(request_id: str, net: str, caller_net: str) -> Message:
    """Returns the message that tells a process that a request is not wanted any more."""
    payload: Mapping[str, object] = {"cancel": True}
    return Message(MessageKind.REQUEST, net, "", request_id, caller_net, payload=payload)


def token_of_job(target: RemotePlace, carried: Carried) -> Message:
    """Returns the message that carries a token of a job to another process."""
    owner = carried.owner
    payload: dict[str, object] = {
        "job": [*owner.key],
        "symbol": owner.symbol,
        "command": [owner.command.symbol, owner.command.arguments, owner.command.priority, owner.command.scope],
        "arguments": owner.arguments,
        "results": carried.results,
        "cancelled": encode_error(carried.cancelled),
        "held": carried.held,
    }
    return Message(
        MessageKind.TOKEN,
        target.net,
        target.place,
        caller_net=carried.net,
        command_id=owner.command.id,
        error=carried.failure,
        payload=payload,
    )


def carried_by(sender: str, message: Message) -> Carried | None:
    """Returns what a token from another process carries, None where it is nobody's; whether it is at home is not told.

    Raises:
        ValueError: It makes no sense.
    """
    if not message.payload:
        return None
    match message.payload:
        case {
            "job": [str(process), str(net), int(number)],
            "symbol": str(symbol),
            "command": [str(name), dict(given), int(priority), str(scope)],
            "arguments": dict(arguments),
            "results": dict(results),
            "cancelled": cancelled,
            "held": bool(held),
        }:
            command = Command(message.command_id, name, given, priority, scope)
            owner = Owner(JobKey(process, net, number), symbol, command, arguments)
            why = decode_error(cancelled)
            return Carried(owner, False, sender, message.caller_net, message.error, results, why, held)
    raise ValueError(f"{str(message.payload)[:200]} does not tell whose a token is")


def tiding_message(to: str, told: TidingArrived) -> Message:
    """Returns the message that tells a net of another process of a job."""
    payload: dict[str, object] = {"job": [*told.key], "tiding": told.tiding.value, "results": told.results}
    return Message(MessageKind.TIDING, to, "", caller_net=told.net, error=told.error, payload=payload)


def tiding_of(message: Message) -> TidingArrived:
    """Returns what a message tells of a job; whether that is at home is not told.

    Raises:
        ValueError: It makes no sense.
    """
    match message.payload:
        case {"job": [str(process), str(net), int(number)], "tiding": str(tiding), "results": dict(results)}:
            key = JobKey(process, net, number)
            return TidingArrived(key, False, Tiding(tiding), message.caller_net, message.error, results)
    raise ValueError(f"{str(message.payload)[:200]} tells nothing of a job")


def cancelled_by(net: str) -> ImError:
    """Returns why a request ends early that its caller cancelled."""
    return ImError(f"cancelled by net {net}", code="cancelled", net=net)


# Inboxes.


class Deliveries:
    """Events for the nets of one process that were put into their inboxes and not taken yet, in order."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Delivery]] = {}

    def put_delivery(self, net: str, event: Delivery) -> None:
        """Notes that an event was put into the inbox of a net."""
        waiting = self._waiting.get(net)
        if waiting is None:
            waiting = self._waiting[net] = deque()
        waiting.append(event)

    def taken(self, net: str, entry: NetEntry) -> None:
        """Notes what a net has recorded: perhaps that it has taken one of these events."""
        waiting = self._waiting.get(net)
        if not waiting or not isinstance(entry, Delivery):
            return
        if waiting[0] is entry:
            waiting.popleft()
            return
        name = _name_of(entry)
        for number, event in enumerate(waiting):
            if _name_of(event) == name:
                del waiting[number]
                return

    def waiting(self) -> dict[str, list[Delivery]]:
        """Returns what waits, by net."""
        return {net: list(events) for net, events in self._waiting.items() if events}


def _name_of(event: Delivery) -> tuple[type, object]:
    """Returns what tells an event from the others of its inbox."""
    match event:
        case TokenArrived(place, count, carried):
            return TokenArrived, (place, count, carried and (carried.owner.key, carried.node, carried.net))
        case TidingArrived(key, _, tiding, net):
            return TidingArrived, (key, tiding, net)
        case NodeForgotten(node):
            return NodeForgotten, node
        case RequestArrived(request):
            return RequestArrived, request.id
        case RequestCancelled(request_id, _):
            return RequestCancelled, request_id
        case ActivityEnded(number, _, _):
            return ActivityEnded, number


class _Door(NamedTuple):
    """A place of a net through which tokens of other nets have come.

    Attributes:
        executor: The net in execution.
        event: A token arrives.
        posted: What the journal is told.
    """

    executor: Executor
    event: TokenArrived
    posted: EventPosted


class Inboxes:
    """Delivers to the nets of one process; what is delivered is journalled.

    Attributes:
        nets: The nets, by name.
        in_work: Requests that were delivered and not answered yet, by name.
        deliveries: What was delivered and not taken yet; kept if there is a journal.
        record: Takes an entry for the journal, which is written before anything leaves; None: no journal is kept.
    """

    def __init__(self) -> None:
        self.nets: dict[str, Executor] = {}
        self.in_work: dict[str, Request] = {}
        self.deliveries = Deliveries()
        self.record: Callable[[ExchangeEntry], None] | None = None
        self._doors: dict[tuple[str, str], _Door] = {}

    def post(self, executor: Executor, event: Arrival | ActionEnded) -> None:
        """Delivers an event.

        Raises:
            NetError: A journal cannot keep it.
        """
        if self.record is not None:
            kept: Delivery
            if isinstance(event, ActionEnded):
                where = f"the results for transition {event.activity.transition}"
                kept = ActivityEnded(event.activity.number, event.error, plain_dict(event.results, where))
            else:
                kept = event
            self.record(EventPosted(executor.net.name, kept))
            self.deliveries.put_delivery(executor.net.name, kept)
        executor.post(event)

    def token(self, net: str, name: str, carried: Carried | None = None) -> str:
        """Delivers a token to a place of a net; returns why not, empty if it was."""
        door = self._doors.get((net, name))
        executor = self.nets[net]
        if door is not None and door.executor is executor and carried is None:
            if self.record is not None:
                self.record(door.posted)
                self.deliveries.put_delivery(net, door.event)
            executor.post(door.event)
            return ""
        place = executor.net.places.get(name)
        if place is None:
            return f"net {net} has no place {name}{nearest(name, executor.net.places)}"
        if not place.remote or name.startswith("I."):
            return f"place {name} of net {net} is not open to other nets (remote: true)"
        event = TokenArrived(name, 1, carried)
        if carried is None:
            self._doors[net, name] = _Door(executor, event, EventPosted(net, event))
        self.post(executor, event)
        return ""

    def request(self, request: Request) -> str:
        """Delivers a request; returns why not, empty if it was.

        Raises:
            NetError: A journal cannot keep it.
        """
        executor = self.nets[request.net]
        offered = [*executor.net.services, *executor.net.symbols()]
        if request.service not in offered:
            return f"net {request.net} offers no service {request.service}{nearest(request.service, offered)}"
        schema = executor.written.arguments_of(request.service)
        if schema is not None:
            try:
                taken = schema.check(request.arguments, f"{request.net}.{request.service}")
            except DataError as error:
                return error.message
            request = replace(request, arguments=taken)
        self.post(executor, RequestArrived(request))
        self.in_work[request.id] = request
        return ""

    def cancel(self, request: Request, why: ImError) -> None:
        """Has a request in work ended early."""
        self.post(self.nets[request.net], RequestCancelled(request.id, why))

    def close(self, request: Request) -> None:
        """Takes note that a request is not in work any more."""
        if self.in_work.pop(request.id, None) is not None and self.record is not None:
            self.record(RequestClosed(request.id))

    def deliver_again(self) -> None:
        """Puts the events into the inboxes that had not been taken, when their nets have been brought back.

        Raises:
            NetError: They do not fit the nets.
            LookupError: Likewise.
        """
        for net, events in self.deliveries.waiting().items():
            executor = self.nets[net]
            for event in self.not_late(net, events):
                if isinstance(event, ActivityEnded):
                    activity = executor.activity(event.number)
                    executor.post(ActionEnded(activity, event.error, event.results))
                else:
                    executor.post(event)

    def not_late(self, net: str, events: list[Delivery]) -> list[Delivery]:
        """Leaves out the replies that have come when their transitions had given up waiting."""
        running = {activity.number for activity in self.nets[net].activities}
        return [event for event in events if not isinstance(event, ActivityEnded) or event.number in running]


# The exchange.


class Transport(Protocol):
    """Carries messages to other processes: a :class:`im_pnt.distributed.link.Link`, or what stands before one."""

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
        self._transport = transport
        self._observer = observer or Observer()
        self._return_timeout_s, self._clock = return_timeout_s, clock
        self._lost: dict[str, tuple[float, str]] = {}

    def add(self, executor: Executor) -> None:
        """Enters a net, in the place of one of the same name that is not busy.

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
        """Enters a net that has taken over the state of one of its name: what that has asked for is answered to it."""
        name = executor.net.name
        waiting = [(each, asked) for each, asked in self.book.items() if asked.executor is self.nets[name]]
        self.nets[name] = executor
        for request_id, asked in waiting:
            self.book.close(request_id)
            self.watch(RequestAsked(request_id, name, asked.activity.number, asked.net, asked.node))

    # What the nets of this process send.

    def send_token(self, net: str, target: RemotePlace, count: int, leaving: Leaving | None = None) -> None:
        """Sends tokens to a place of another net; with what they take along, where they are of a job."""
        message, carried = token_message(target.net, target.place), None
        if leaving is not None:
            carried = self._carried(net, target.net, leaving)
            message = token_of_job(target, carried)
        for _ in range(count):
            if target.net in self.nets:
                self._kept(message, self.inboxes.token(target.net, target.place, carried))
            elif self._transport is not None:
                self._transport.send(self._transport.node_of(target.net), message)
            else:
                self._kept(message, f"there is no net {target.net}{nearest(target.net, self.nets)}")

    def _carried(self, net: str, target: str, leaving: Leaving) -> Carried:
        job, failure, results, held = leaving
        if job.visit is not None:
            owner = job.visit.owner
        else:
            symbol = job.symbol if job.from_tape else ""
            owner = Owner(self._key_of(net, job), symbol, job.command, job.arguments)
        cancelled = (job.last_failure or cancelled_by(net)) if job.cancelled else None
        return Carried(owner, self._is_home(owner.key, target), "", net, failure, results, cancelled, held)

    def _key_of(self, net: str, job: Job) -> JobKey:
        return JobKey(self.book.prefix, net, job.number) if job.visit is None else job.visit.owner.key

    def _is_home(self, key: JobKey, net: str) -> bool:
        return key.process == self.book.prefix and key.net == net

    def send_tiding(
        self, net: str, job: Job, tiding: Tiding, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Tells another net of a job whose tokens have crossed."""
        told = TidingArrived(self._key_of(net, job), False, tiding, net, error, results)
        self._send_tiding("" if to in self.nets or self._transport is None else self._transport.node_of(to), to, told)

    def send_settled(
        self, net: str, key: JobKey, node: str, to: str, error: ImError | None, results: dict[str, object]
    ) -> None:
        """Tells the net that has sent a token of a job that the work of that is done."""
        self._send_tiding(node, to, TidingArrived(key, False, Tiding.SETTLED, net, error, results))

    def _send_tiding(self, node: str, to: str, told: TidingArrived) -> None:
        if node and self._transport is not None:
            self._transport.send(node, tiding_message(to, told))
        elif to in self.nets:
            self.inboxes.post(self.nets[to], replace(told, home=self._is_home(told.key, to)))

    def send_request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Sends a request; its reply, or why there is none, ends the activity."""
        action = activity.action
        assert isinstance(action, RequestAction)
        local = action.net in self.nets
        node = "" if local or self._transport is None else self._transport.node_of(action.net)
        request_id = self.book.next_name()
        job = activity.lineage.job
        command = job.command if job else Command(scope=scope_of(activity.net, NO_COMMAND))
        request = Request(
            request_id, action.net, action.service, "", activity.net, activity.transition, command, arguments
        )
        self._happens(RequestAsked(request_id, activity.net, activity.number, action.net, node))
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

    def awaits_reply(self, activity: Activity) -> bool:
        """Whether a request has been sent for an activity, and its reply is still to come."""
        return self.book.of_activity(activity) is not None

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request of whatever process."""
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
            message = Message(
                MessageKind.REPLY, request.caller_net, "", request.id, error=error, payload={"results": results}
            )
            self._transport.send(request.caller_node, message)

    def _cancel_request(self, activity: Activity) -> None:
        found = self.book.of_activity(activity)
        if found is None:
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
        if kind is MessageKind.TOKEN and message.net in self.nets:
            return self._token_from(sender, message)
        if kind is MessageKind.VOID:
            return ""
        if kind is MessageKind.REPLY:
            results = message.payload.get("results")
            if not self._answer(message.request_id, message.error, results if isinstance(results, dict) else {}):
                self._dropped(f"nobody waits for reply {message.request_id} of {sender} any more")
            return ""
        if message.net not in self.nets:
            return f"there is no net {message.net} here{nearest(message.net, self.nets)}"
        if kind is MessageKind.TIDING:
            told = tiding_of(message)
            self.inboxes.post(self.nets[message.net], replace(told, home=self._is_home(told.key, message.net)))
            return ""
        if message.payload.get("cancel") is True:
            request = self.inboxes.in_work.get(message.request_id)
            if request is not None and request.caller_node == sender:
                self.inboxes.cancel(request, cancelled_by(message.caller_net))
            return ""
        if message.request_id in self.inboxes.in_work:
            return f"request {message.request_id} is in work already"
        return self.inboxes.request(request_of(sender, message))

    def _token_from(self, sender: str, message: Message) -> str:
        carried = carried_by(sender, message)
        if carried is not None:
            carried = replace(carried, home=self._is_home(carried.owner.key, message.net))
        return self.inboxes.token(message.net, message.place, carried)

    def refused(self, message: Message, why: str) -> None:
        """Takes back a message that its receiver refused; a token is kept as undeliverable."""
        if message.kind is MessageKind.TOKEN:
            self._kept(message, why)
        elif message.kind is not MessageKind.REQUEST or not self._answer(message.request_id, NetError(why), {}):
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

    def node_reset(self, node: str, why: str, in_flight: list[Message]) -> None:
        """A node and this one do not remember the same: what one has asked the other is given up.

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

    def _give_up(self, node: str, why: str) -> None:
        for name, executor in self.nets.items():
            nets = self._nets_of(node, executor)
            if executor.concerned(node, nets):
                self.inboxes.post(self.nets[name], NodeForgotten(node, nets, LinkError(why, node=node)))
        for request_id, waiting in self.book.of_node(node):
            if self._transport is not None:
                self._transport.forget(request_id)
                self._transport.send(node, cancel_message(request_id, waiting.net, waiting.activity.net))
            self._answer(request_id, LinkError(why, node=node), {})
        for request in list(self.inboxes.in_work.values()):
            if request.caller_node == node:
                self.inboxes.close(request)
                self.inboxes.cancel(request, LinkError(why, node=node))

    def _nets_of(self, node: str, executor: Executor) -> tuple[str, ...]:
        """Returns the nets of a node to which a net gives tokens."""
        if self._transport is None:
            return ()
        given = {target.net for each in executor.net.transitions.values() for target in each.remote_outputs}
        return tuple(sorted(net for net in given - self.nets.keys() if self._transport.node_of(net) == node))

    def partners(self) -> frozenset[str]:
        """Returns the nodes that requests wait for, those that wait for replies, and those where tokens of jobs are."""
        asked = {waiting.node for _, waiting in self.book.items() if waiting.node}
        for executor in self.nets.values():
            for job in executor.jobs():
                asked |= {job.visit.node} if job.visit is not None and job.visit.node else set()
                if job.away and self._transport is not None:
                    asked |= {self._transport.node_of(net) for net in job.away if net not in self.nets}
        return frozenset(asked | {r.caller_node for r in self.inboxes.in_work.values() if r.caller_node})

    def tidy(self) -> None:
        """Gives up nodes that have not returned in time, and drops requests whose transitions wait no more."""
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
        """Enters a request, and has it cancelled when its activity is.

        Raises:
            NetError: The activity does not run.
            LookupError: The net is not there.
        """
        executor = self.nets[asked.net]
        activity = executor.activity(asked.number)
        self.book.open(asked.request_id, Waiting(executor, activity, asked.asked, asked.node))
        activity.on_cancel.append(lambda: self._cancel_request(activity))

    def _answer(self, request_id: str, error: ImError | None, results: dict[str, object]) -> bool:
        """Ends a request with its reply; returns whether anybody waited for it."""
        waiting = self.book.get(request_id)
        if waiting is None:
            return False
        self.inboxes.post(waiting.executor, ActionEnded(waiting.activity, error, results))
        self._happens(RequestAnswered(request_id))
        return True

    def _kept(self, message: Message, why: str) -> None:
        """Keeps a token that nobody wants, where it is seen and counted."""
        if why:
            self._happens(TokenKept(message.net, message.place))
            self._dropped(f"{message} is undeliverable and kept: {why}")
            carried = carried_by("", message)
            if carried is not None:
                self.send_settled(message.net, carried.owner.key, "", carried.net, NetError(why), {})

    # What happens to the exchange, now and when a journal is replayed.

    def _happens(self, entry: ExchangeEntry) -> None:
        if self.inboxes.record is not None:
            self.inboxes.record(entry)
        self.replay(entry)

    def replay(self, entry: ExchangeEntry) -> None:
        """Does what an entry tells; nothing is posted or sent.

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
            case TokenKept(net, place):
                self.undeliverable[RemotePlace(net, place)] += 1

    def _dropped(self, why: str) -> None:
        self._observer.troubled("", why)
