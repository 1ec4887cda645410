"""How a process is brought back from its log: its snapshot, then batch after batch what has happened since."""

from collections.abc import Mapping

from im_core.errors import ImError
from im_pnt.exchange import Exchange
from im_pnt.journal.errors import JournalError
from im_pnt.journal.exchange_record import deliver_again, replay_exchange, restore_exchange
from im_pnt.journal.link_record import replay_link, restore_link
from im_pnt.journal.log import Recovered
from im_pnt.link import Link


def bring_back(recovered: Recovered, exchange: Exchange, link: Link) -> None:
    """Brings everything back as it was when the last batch was written.

    Args:
        recovered: What the log held.
        exchange: With nets to which nothing has happened.
        link: To other processes.

    Raises:
        JournalError: A record does not fit; names file, offset and number.
    """
    number, offset = 2, 0
    try:
        _restore(recovered.state, exchange, link)
        for record, batch in recovered.batches:
            number, offset = record.number, record.offset
            for entry in batch:
                _replay(entry, exchange, link)
        deliver_again(exchange)
    except (ImError, ValueError, LookupError, TypeError, AttributeError, AssertionError) as error:
        raise JournalError(
            f"{recovered.file}: record {number} at byte {offset} does not fit what was before it "
            f"({type(error).__name__}: {error}); nothing was started. Move the journal aside with Journal.discard and "
            "begin anew",
            file=recovered.file,
            record=number,
            offset=offset,
        ) from error


def _restore(state: Mapping[str, object], exchange: Exchange, link: Link) -> None:
    match state:
        case {"nets": dict(nets), "exchange": dict(exchanged), "link": dict(linked)}:
            for name, content in nets.items():
                exchange.nets[name].restore(content)
            restore_exchange(exchange, exchanged)
            restore_link(link, linked)
        case _:
            raise ValueError("the snapshot has no nets, exchange and link")


def _replay(entry: object, exchange: Exchange, link: Link) -> None:
    match entry:
        case ["net", str(net), list(content)]:
            exchange.nets[net].replay(content)
            exchange.inboxes.deliveries.taken(net, content)
        case ["exchange", list(content)]:
            replay_exchange(exchange, content)
        case ["link", list(content)]:
            replay_link(link, content)
        case _:
            raise ValueError(f"{str(entry)[:200]} is no entry")
