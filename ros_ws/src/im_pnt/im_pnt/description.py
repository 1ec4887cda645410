"""The description of a net, as in the field ``json`` of ``/pnt/nets``: one reader for all nodes."""

import pydantic

from im_core.errors import DataError
from im_core.text.bounded_json import read_json
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net


class NetContent(pydantic.BaseModel):
    """Description of a net.

    Attributes:
        yaml: Text of its file.
        journal: Whether its node keeps a journal.
    """

    yaml: str
    journal: bool = False


def read_content(name: str, text: str) -> NetContent:
    """Read the description of a net, without the net.

    Raises:
        DataError: It is none of that.
    """
    return read_json(NetContent, text, f"the description of net {name}")


def read_net(name: str, text: str, node: str) -> Net:
    """Read a net.

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
