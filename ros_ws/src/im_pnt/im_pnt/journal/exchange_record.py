"""What a journal keeps of an exchange: requests asked and in work, tokens that nobody wants, events not taken."""

from collections.abc import Mapping

from im_pnt.deliveries import decode_delivery
from im_pnt.exchange import Exchange
from im_pnt.net import RemotePlace
from im_pnt.record import Entry, decode_request, encode_request
from im_pnt.requests import Waiting


def exchange_state(exchange: Exchange) -> dict[str, object]:
    """Returns an exchange as JSON data."""
    book = exchange.book
    waiting = exchange.inboxes.deliveries.waiting()
    asked = [[name, w.executive.net.name, w.activity.number, w.net, w.node] for name, w in book.items()]
    return {
        "requests": [book.prefix, book.count],
        "asked": asked,
        "in_work": [encode_request(request) for request in exchange.inboxes.in_work.values()],
        "undeliverable": [[net, place, count] for (net, place), count in exchange.undeliverable.items()],
        "posted": {net: _not_late(exchange, net, entries) for net, entries in waiting.items()},
    }


def restore_exchange(exchange: Exchange, state: Mapping[str, object]) -> None:
    """Brings an exchange back whose nets have been brought back.

    Raises:
        ValueError: It is no state of an exchange.
        LookupError: It speaks of nets or activities that are not there.
    """
    match state:
        case {
            "requests": [str(prefix), int(count)],
            "asked": list(asked),
            "in_work": list(in_work),
            "undeliverable": list(undeliverable),
            "posted": dict(posted),
        }:
            exchange.book.prefix, exchange.book.count = prefix, count
            for entry in asked:
                _asked(exchange, entry)
            for request in map(decode_request, in_work):
                exchange.inboxes.in_work[request.id] = request
            for net, entries in posted.items():
                for each in entries:
                    exchange.inboxes.deliveries.put(net, each)
            for net, place, count in undeliverable:
                exchange.undeliverable[RemotePlace(net, place)] = count
        case _:
            raise ValueError(f"{str(state)[:200]} is no state of an exchange")


def replay_exchange(exchange: Exchange, entry: list[object]) -> None:
    """Repeats what an entry tells.

    Raises:
        ValueError: It is no entry of an exchange.
        LookupError: It speaks of nets, requests or activities that are not there.
    """
    match entry:
        case ["posted", str(net), list(delivery)]:
            exchange.inboxes.deliveries.put(net, delivery)
            if delivery[0] == "request":
                request = decode_request(delivery[1])
                exchange.inboxes.in_work[request.id] = request
        case ["asked", *asked]:
            exchange.book.count += 1
            _asked(exchange, asked)
        case ["answered", str(request_id)]:
            exchange.book.close(request_id)
        case ["closed", str(request_id)]:
            del exchange.inboxes.in_work[request_id]
        case ["undeliverable", str(net), str(place)]:
            exchange.undeliverable[RemotePlace(net, place)] += 1
        case _:
            raise ValueError(f"{str(entry)[:200]} is no entry of an exchange")


def deliver_again(exchange: Exchange) -> None:
    """Puts the events into the inboxes that had not been taken.

    Raises:
        ImError: They do not fit the nets.
        ValueError: Likewise.
    """
    for net, entries in exchange.inboxes.deliveries.waiting().items():
        executive = exchange.nets[net]
        for entry in _not_late(exchange, net, entries):
            executive.post(decode_delivery(executive, entry))


def _not_late(exchange: Exchange, net: str, entries: list[Entry]) -> list[Entry]:
    """Leaves out the replies that have come when their transitions had given up waiting."""
    running = {activity.number for activity in exchange.nets[net].activities}
    return [entry for entry in entries if entry[0] != "ended" or entry[1] in running]


def _asked(exchange: Exchange, entry: list[object]) -> None:
    match entry:
        case [str(request_id), str(net), int(number), str(asked), str(node)]:
            executive = exchange.nets[net]
            exchange.watch(request_id, Waiting(executive, executive.activity(number), asked, node))
        case _:
            raise ValueError(f"{str(entry)[:200]} is no request")
