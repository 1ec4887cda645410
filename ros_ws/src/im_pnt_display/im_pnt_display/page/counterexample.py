"""Counterexample on the page: the markings of the firings, and drawings of the markings."""

from collections.abc import Sequence

from im_pnt.model.net import Net
from im_pnt_analysis.simulation.replay import FiringSequence, replay
from im_pnt_display.page.state import net_content


def drawn_counterexample(nets: Sequence[Net], firings: FiringSequence) -> dict[str, object]:
    """Return the steps of a firing sequence, with the drawings, as JSON data.

    Args:
        nets: The nets that it is for, as written.
        firings: The sequence, for instance a counterexample.

    Raises:
        NetError: The sequence does not fit to the nets.
    """
    steps = [{"fired": step.transition, "markings": _by_net(nets, step.marking)} for step in replay(nets, firings)]
    return {
        "reason": firings.reason,
        "drawings": [net_content(net) for net in nets],
        "steps": steps,
        "repeats": len(firings.sequence) if firings.repeat else None,
    }


def _by_net(nets: Sequence[Net], marking: dict[str, int]) -> dict[str, dict[str, int]]:
    """Take the marking of a composition apart; places of the environment are left out."""
    if len(nets) == 1:
        return {nets[0].name: marking}
    parts: dict[str, dict[str, int]] = {net.name: {} for net in nets}
    for name, count in marking.items():
        net, _, place = name.partition(".")
        if net in parts:
            parts[net][place] = count
    return parts
