"""Descriptions of a net, as in the field ``json`` of ``/pnt/nets``, and of the commands of nets."""

from collections.abc import Iterable, Mapping

import pydantic

from im_core.errors import DataError
from im_core.text.bounded_json import read_json
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net


class NetContent(pydantic.BaseModel):
    """Description of a net."""

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

    Raises:
        DataError: It is no description, or that of another net.
        NetFileError: It is no net.
    """
    net = parse_net(read_content(name, text).yaml, node)
    if net.name != name:
        raise DataError(f"the description of net {name} is that of net {net.name}", net=name)
    return net


def describe_commands(nets: Iterable[Net], left_out: Mapping[str, str]) -> dict[str, object]:
    """Return the description of commands, as JSON on ``/<node>/commands``.

    Symbol, net and description of each; where the net declares it, also the JSON schema of its arguments; and where it
    needs what there is once, ``needs``, ``busy`` and ``priority``.

    Args:
        nets: Nets of the commands.
        left_out: Why nets are not loaded: the cell lacks what they need; by the net's name.
    """
    told: dict[str, dict[str, object]] = {}
    for net in nets:
        for symbol in net.symbols():
            entry = _command(net, symbol)
            if "needs" in entry or symbol not in told:  # who does it tells more than who hands it on
                told[symbol] = entry
    return {"commands": list(told.values()), "left_out": dict(left_out)}


def _command(net: Net, symbol: str) -> dict[str, object]:
    told: dict[str, object] = {"symbol": symbol, "net": net.name, "description": net.description}
    declared = net.commands.get(symbol)
    if declared is None:
        return told
    told |= {"description": declared.description or net.description, "arguments": declared.arguments.json_schema()}
    if declared.needs:
        told |= {"needs": list(declared.needs), "busy": declared.busy.value, "priority": declared.priority}
    return told
