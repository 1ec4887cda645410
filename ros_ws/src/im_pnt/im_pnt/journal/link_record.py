"""What a journal keeps of a link: the streams to and from every other process."""

from collections.abc import Mapping

from im_pnt.link import Link
from im_pnt.streams import Peer


def link_state(link: Link) -> dict[str, object]:
    """Returns a link as JSON data."""
    return {"epoch": link.epoch, "peers": {node: peer.state() for node, peer in link.peers.items()}}


def restore_link(link: Link, state: Mapping[str, object]) -> None:
    """Brings the streams of a link back; everything that was not acknowledged is sent again.

    Raises:
        ValueError: It is no state of a link.
    """
    match state:
        case {"epoch": int(epoch), "peers": dict(peers)}:
            link.epoch = epoch
            link.peers = {str(node): Peer.restored(node, peer) for node, peer in peers.items()}
        case _:
            raise ValueError(f"{str(state)[:200]} is no state of a link")


def replay_link(link: Link, entry: list[object]) -> None:
    """Repeats what an entry tells.

    Raises:
        ValueError: It is no entry of a link, or does not fit.
    """
    match entry:
        case ["epoch", int(epoch)]:
            link.epoch = epoch
        case [str(kind), str(node), *rest]:
            link.peers.setdefault(node, Peer(node)).replay(kind, rest)
        case _:
            raise ValueError(f"{str(entry)[:200]} is no entry of a link")
