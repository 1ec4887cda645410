"""What an exchange has put into the inboxes of its nets, kept for the journal until the nets have taken it.

Written down, an event reads as the net that takes it records it (:mod:`im_pnt.record`): so it is known when it was.
"""

from collections import deque

from im_pnt.errors import NetError
from im_pnt.events import ActionEnded, Event, RequestArrived, RequestCancelled, TokenArrived
from im_pnt.executive import Executive
from im_pnt.record import Entry, decode_request, encode_request, plain
from im_pnt.remote import decode_error, encode_error


class Deliveries:
    """Events for the nets of one process that were put into their inboxes and not taken yet, in order."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Entry]] = {}

    def put(self, net: str, entry: Entry) -> None:
        """Notes that an event was put into the inbox of a net."""
        waiting = self._waiting.get(net)
        if waiting is None:
            waiting = self._waiting[net] = deque()
        waiting.append(entry)

    def taken(self, net: str, entry: Entry) -> None:
        """Notes what a net has recorded: perhaps that it has taken one of these events."""
        waiting = self._waiting.get(net)
        if waiting:
            if waiting[0] == entry:
                waiting.popleft()
            elif entry in waiting:
                waiting.remove(entry)

    def waiting(self) -> dict[str, list[Entry]]:
        """Returns what waits, by net."""
        return {net: list(entries) for net, entries in self._waiting.items() if entries}


def encode_delivery(event: Event) -> Entry:
    """Writes an event.

    Raises:
        NetError: Its arguments or results are not JSON data.
    """
    match event:
        case TokenArrived(place, count):
            return ["token", place, count]
        case RequestArrived(request):
            return ["request", encode_request(request)]
        case RequestCancelled(request_id, error):
            return ["request_cancelled", request_id, encode_error(error)]
        case ActionEnded(activity, error, results):
            where = f"the results for transition {activity.transition}"
            return ["ended", activity.number, encode_error(error), plain(results, where)]
    raise AssertionError(f"an exchange does not post {event}")


def decode_delivery(executive: Executive, entry: Entry) -> Event:
    """Reads an event for a net.

    Raises:
        NetError: It is none.
        ValueError: Likewise.
        LookupError: It speaks of an activity that is not there.
    """
    match entry:
        case ["token", str(place), int(count)]:
            return TokenArrived(place, count)
        case ["request", request]:
            return RequestArrived(decode_request(request))
        case ["request_cancelled", str(request_id), error]:
            reason = decode_error(error)
            if reason is not None:
                return RequestCancelled(request_id, reason)
        case ["ended", int(number), error, dict(results)]:
            return ActionEnded(executive.activity(number), decode_error(error), results)
    raise NetError(f"{str(entry)[:200]} is no delivery")
