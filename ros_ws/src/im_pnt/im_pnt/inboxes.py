"""The nets of one process, and what an exchange puts into their inboxes."""

from collections.abc import Callable
from typing import NamedTuple

from im_core.errors import ImError
from im_pnt.deliveries import Deliveries, encode_delivery
from im_pnt.errors import nearest
from im_pnt.events import Event, RequestArrived, RequestCancelled, TokenArrived
from im_pnt.executive import Executive
from im_pnt.jobs import Request
from im_pnt.record import Entry


class _Door(NamedTuple):
    """A place of a net through which tokens of other nets have come.

    Attributes:
        executive: The net in execution.
        event: A token arrives.
        entry: The event, written down.
        posted: What the journal is told.
    """

    executive: Executive
    event: TokenArrived
    entry: Entry
    posted: Entry


class Inboxes:
    """Delivers to the nets of one process; what is delivered is journalled.

    Attributes:
        nets: The nets, by name.
        in_work: Requests that were delivered and not answered yet, by name.
        deliveries: What was delivered and not taken yet; kept if there is a journal.
        record: Takes an entry for the journal, which is written before anything leaves; None: no journal is kept.
    """

    def __init__(self) -> None:
        self.nets: dict[str, Executive] = {}
        self.in_work: dict[str, Request] = {}
        self.deliveries = Deliveries()
        self.record: Callable[[Entry], None] | None = None
        self._doors: dict[tuple[str, str], _Door] = {}

    def post(self, executive: Executive, event: Event) -> None:
        """Delivers an event.

        Raises:
            NetError: A journal cannot keep it.
        """
        if self.record is not None:
            name, entry = executive.net.name, encode_delivery(event)
            self.record(["posted", name, entry])
            self.deliveries.put(name, entry)
        executive.post(event)

    def token(self, net: str, name: str) -> str:
        """Delivers a token to a place of a net; returns why not, empty if it was."""
        door = self._doors.get((net, name))
        executive = self.nets[net]
        if door is not None and door.executive is executive:
            if self.record is not None:
                self.record(door.posted)
                self.deliveries.put(net, door.entry)
            executive.post(door.event)
            return ""
        place = executive.net.places.get(name)
        if place is None:
            return f"net {net} has no place {name}{nearest(name, executive.net.places)}"
        if not place.remote or name.startswith("I."):
            return f"place {name} of net {net} is not open to other nets (remote: true)"
        event = TokenArrived(name, 1)
        entry = encode_delivery(event)
        self._doors[net, name] = _Door(executive, event, entry, ["posted", net, entry])
        self.post(executive, event)
        return ""

    def request(self, request: Request) -> str:
        """Delivers a request; returns why not, empty if it was.

        Raises:
            NetError: A journal cannot keep it.
        """
        executive = self.nets[request.net]
        offered = [*executive.net.services, *executive.net.symbols()]
        if request.service not in offered:
            return f"net {request.net} offers no service {request.service}{nearest(request.service, offered)}"
        self.post(executive, RequestArrived(request))
        self.in_work[request.id] = request
        return ""

    def cancel(self, request: Request, why: ImError) -> None:
        """Has a request in work ended early."""
        self.post(self.nets[request.net], RequestCancelled(request.id, why))

    def close(self, request: Request) -> None:
        """Takes note that a request is not in work any more."""
        if self.in_work.pop(request.id, None) is not None and self.record is not None:
            self.record(["closed", request.id])
