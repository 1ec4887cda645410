"""The inboxes of the nets of one process, with delivered events until the firing."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from im_core.errors import DataError, ImError, nearest
from im_pnt.execution.events import (
    ActionEnded,
    CommandHeld,
    JobUpdateArrived,
    NodeForgotten,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Request, TokenContext
from im_pnt.execution.journal_entries import ActivityEnded, NetEntry, plain_dict
from im_pnt_node.distributed.entries import Arrival, Delivery, EventPosted, ExchangeEntry, RequestClosed


class Deliveries:
    """Delivered events for the nets of one process, not yet taken by the nets, in order."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Delivery]] = {}

    def put_delivery(self, net: str, event: Delivery) -> None:
        """Note an event in the inbox of a net."""
        waiting = self._waiting.get(net)
        if waiting is None:
            waiting = self._waiting[net] = deque()
        waiting.append(event)

    def taken(self, net: str, entry: NetEntry) -> None:
        """Note a recorded event of a net: perhaps a delivered one."""
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
        """Return the waiting events, by net."""
        return {net: list(events) for net, events in self._waiting.items() if events}


def _name_of(event: Delivery) -> tuple[type, object]:
    """Return the identity of an event among the others of the inbox."""
    match event:
        case TokenArrived(place, count, context):
            return TokenArrived, (place, count, context and (context.owner.key, context.node, context.net))
        case JobUpdateArrived(key, _, update, net):
            return JobUpdateArrived, (key, update, net)
        case NodeForgotten(node):
            return NodeForgotten, node
        case RequestArrived(request):
            return RequestArrived, request.id
        case RequestCancelled(request_id, _):
            return RequestCancelled, request_id
        case RequestHeld(request_id, held):
            return RequestHeld, (request_id, held)
        case CommandHeld(command_id, held):
            return CommandHeld, (command_id, held)
        case ActivityEnded(number):
            return ActivityEnded, number


class _Door(NamedTuple):
    """A place of a net through which tokens of other nets have come."""

    executor: Executor
    event: TokenArrived
    posted: EventPosted


class Inboxes:
    """Deliverer to the nets of one process; deliveries are journalled.

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
        """Deliver an event.

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

    def token(self, net: str, name: str, context: TokenContext | None = None) -> str:
        """Deliver a token to a place of a net; return the reason of a failure, empty without one."""
        door = self._doors.get((net, name))
        executor = self.nets[net]
        if door is not None and door.executor is executor and context is None:
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
        event = TokenArrived(name, 1, context)
        if context is None:
            self._doors[net, name] = _Door(executor, event, EventPosted(net, event))
        self.post(executor, event)
        return ""

    def request(self, request: Request, held: bool) -> str:
        """Deliver a request, which may be held; return the reason of a failure, empty without one.

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
        self.post(executor, RequestArrived(request, held))
        self.in_work[request.id] = request
        return ""

    def hold(self, request_id: str, held: bool) -> None:
        """Have nothing begun for a request in work, or have the request go on."""
        if (request := self.in_work.get(request_id)) is not None:
            self.post(self.nets[request.net], RequestHeld(request_id, held))

    def cancel(self, request: Request, why: ImError) -> None:
        """Has a request in work ended early."""
        self.post(self.nets[request.net], RequestCancelled(request.id, why))

    def close(self, request: Request) -> None:
        """Note the end of the work for a request."""
        if self.in_work.pop(request.id, None) is not None and self.record is not None:
            self.record(RequestClosed(request.id))

    def deliver_again(self) -> None:
        """Put untaken events into the inboxes again, after the return of the nets.

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
        """Leave out replies without a waiting transition."""
        running = {activity.number for activity in self.nets[net].activities}
        return [event for event in events if not isinstance(event, ActivityEnded) or event.number in running]
