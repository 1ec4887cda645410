"""The description of a net, as in the field ``json`` of ``/pnt/nets``: read by all who hear it in one way."""

import pydantic

from im_core.bounded_json import read_json
from im_core.errors import DataError
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net


class NetContent(pydantic.BaseModel):
    """What is told of a net.

    Attributes:
        yaml: Text of its file.
        journal: Whether its node keeps a journal.
    """

    yaml: str
    journal: bool = False


def read_content(name: str, text: str) -> NetContent:
    """Reads what is told of a net, but not the net.

    Raises:
        DataError: It is none of that.
    """
    return read_json(NetContent, text, f"the description of net {name}")


def read_net(name: str, text: str, node: str) -> Net:
    """Reads a net.

    Args:
        name: Its name.
        text: JSON of its description.
        node: Who tells it, for complaints.

    Raises:
        DataError: It is no description, or that of another net.
        NetFileError: It is no net.
    """
    net = parse_net(read_content(name, text).yaml, node)
    if net.name != name:
        raise DataError(f"the description of net {name} is that of net {net.name}", net=name)
    return net
