"""Events of a node in a bag: one stream for each incarnation of each node."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from pydantic import BaseModel, ConfigDict, Field

from im_core.errors import DataError
from im_core.text.bounded_json import read_json
from im_pnt_node.rerun.log import Key

Item = list[object]


class _Told(BaseModel):
    """A message of ``/pnt/events``."""

    model_config = ConfigDict(strict=True)
    node: str
    incarnation: str = Field(alias="life")
    number: int
    at: float
    stamp: float
    items: list[Item]


@dataclass(frozen=True)
class Turn:
    """A turn of the loop of a node.

    Attributes:
        at: When it was over, by the node's monotonic clock [s].
        stamp: The same in testbed time [s].
        items: What was told, see :mod:`im_pnt_node.rerun.log`.
    """

    at: float
    stamp: float
    items: list[Item]


@dataclass
class NodeStream:
    """Recorded incarnation of a node.

    Attributes:
        node: Its full name.
        functions: What makes the functions of its nets, ``module:function``; empty: nobody can.
        turns: Its turns.
    """

    node: str
    functions: str = ""
    turns: list[Turn] = field(default_factory=list)


def streams_of(texts: Iterable[str]) -> list[NodeStream]:
    """Sort recorded events by nodes and the incarnations, in the order of the beginnings.

    Args:
        texts: The messages, in the order of each node.

    Raises:
        DataError: One is no such message, or some are missing.
    """
    incarnations: dict[str, NodeStream] = {}
    numbers: dict[str, int] = {}
    before: dict[str, str] = {}  # nodes, by incarnation, that were told of: where others listen, the state comes later
    for text in texts:
        told = read_json(_Told, text, "a message of /pnt/events")
        items, stream = told.items, incarnations.get(told.incarnation)
        if stream is None:
            begins = next((rank for rank, item in enumerate(items) if item[:1] == ["node"]), None)
            if begins is None:
                before[told.incarnation] = told.node
                continue
            match items[begins]:
                case ["node", str(node), str(functions)]:
                    stream = incarnations[told.incarnation] = NodeStream(node, functions)
                case _:
                    raise DataError(f"{str(items[begins])[:100]} is not what a node tells of itself")
            items = items[begins:]
        elif told.number != (last := numbers[told.incarnation]) + 1:
            raise DataError(
                f"messages {last + 1} to {told.number - 1} of {told.node} on /pnt/events are not in the bag: without "
                "them its nets cannot be run again",
                node=told.node,
            )
        numbers[told.incarnation] = told.number
        stream.turns.append(Turn(told.at, told.stamp, items))
    if never := sorted(before[each] for each in before.keys() - incarnations.keys()):
        raise DataError(
            f"the recording of {never[0]} does not begin with the state of its nets: its beginning is missing",
            node=never[0],
        )
    return list(incarnations.values())


def named(key: Key) -> str:
    """Return the name for the lookup of a key."""
    return "\x00".join(map(str, key))
