"""What the page draws: a net as plain data, and a firing sequence as the markings that it leads through."""

from collections.abc import Sequence

from im_pnt.draw import draw
from im_pnt.net import Net
from im_pnt.replay import Script, replay


def description(net: Net) -> dict[str, object]:
    """Returns the structure and drawing of a net, as JSON data."""
    return {
        "net": net.name,
        "description": net.description,
        "symbols": net.symbols(),
        "services": sorted(net.services),
        "drawing": draw(net).to_dict(),
    }


def story(nets: Sequence[Net], script: Script) -> dict[str, object]:
    """Returns the steps of a firing sequence, with the drawings to see them on, as JSON data.

    Args:
        nets: The nets that it is for, as written.
        script: The sequence, for instance a counterexample.

    Raises:
        NetError: The sequence does not fit to the nets.
    """
    steps = [{"fired": step.transition, "markings": _by_net(nets, step.marking)} for step in replay(nets, script)]
    return {
        "reason": script.reason,
        "drawings": [description(net) for net in nets],
        "steps": steps,
        "repeats": len(script.sequence) if script.repeat else None,
    }


def _by_net(nets: Sequence[Net], marking: dict[str, int]) -> dict[str, dict[str, int]]:
    """Takes the marking of a composition apart; places of its environment are left out."""
    if len(nets) == 1:
        return {nets[0].name: marking}
    parts: dict[str, dict[str, int]] = {net.name: {} for net in nets}
    for name, count in marking.items():
        net, _, place = name.partition(".")
        if net in parts:
            parts[net][place] = count
    return parts
