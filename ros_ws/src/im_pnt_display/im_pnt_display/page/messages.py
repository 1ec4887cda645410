"""Messages of nodes on the nets, as plain data for the page. Senseless messages are refused with a sentence."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from im_core.errors import DataError, ImError
from im_core.text.bounded_json import read_json
from im_pnt.description import read_net
from im_pnt.execution.notification import Phase
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net
from im_pnt_analysis.simulation.replay import FiringSequence, replay
from im_pnt_display.page.state import net_content


class _Refusal(BaseModel):
    reason: str = ""
    nets: list[str] = []
    sequence: list[str] = []
    repeat: list[str] = []


def described_net(name: str, text: str, node: str) -> dict[str, object]:
    """Read and draw a net.

    Args:
        name: Its name.
        text: JSON as in ``/pnt/nets``; the text of the net is under ``yaml``.
        node: Who tells it, for complaints.

    Raises:
        ImError: It is no net, or another one.
    """
    return net_content(read_net(name, text, node))


def counterexample(text: str) -> dict[str, object]:
    """Read and draw the counterexample of a refused net; empty where there is nothing to play.

    Args:
        text: JSON as in ``/pnt/refusals``: the texts of the nets, the sequence, what is repeated, and the reason.

    Raises:
        ImError: One of them is no net, or the sequence does not fit to them.
    """
    refusal = read_json(_Refusal, text, "a refusal")
    nets = [parse_net(net, "refused net") for net in refusal.nets]
    if not nets:
        return {}
    firings = FiringSequence(tuple(refusal.sequence), tuple(refusal.repeat), refusal.reason)
    return drawn_counterexample(nets, firings)


def drawn_counterexample(nets: Sequence[Net], firings: FiringSequence) -> dict[str, object]:
    """Return the steps of a firing sequence, with the drawings, as JSON data.

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


def token_counts(places: Sequence[str], tokens: Sequence[int]) -> dict[str, int]:
    """Read the tokens of places, as in ``/pnt/markings``.

    Raises:
        ImError: There are not as many numbers as places.
    """
    if len(places) != len(tokens):
        raise ImError(f"it has {len(places)} places and {len(tokens)} numbers of tokens", code="input")
    return {place: int(count) for place, count in zip(places, tokens, strict=True)}


def firing_content(at_s: float, told: Any) -> dict[str, object]:
    """Return a firing for the page.

    Args:
        at_s: When it was [s].
        told: A message of ``/pnt/firings``, or what is kept of one.

    Raises:
        ImError: A number of it is none.
    """
    return {
        "time": at_s,
        "net": told.net,
        "transition": told.transition,
        "sequence": int(told.sequence),
        "phase": phase_name(told.phase),
        "symbol": told.symbol,
        "command": int(told.command_id),
        "message": told.message,
        "duration": finite("duration", told.duration),
        "progress": finite("progress", told.progress),
    }


def phase_name(phase: int) -> str:
    """Return the name of a phase of ``/pnt/firings``; of an unknown one, the number."""
    return Phase(phase).name if phase in list(Phase) else str(phase)


def finite(name: str, value: float) -> float:
    """Return a number of a message.

    Raises:
        ImError: It is none; JSON could not say it, and no page could read it.
    """
    if not math.isfinite(value):
        raise ImError(f"its {name} is {value}", code="input")
    return value


def result_pictures(results: Mapping[str, str], folder: Path) -> list[str]:
    """Return the pictures that a command left, as paths below the folder of results.

    Args:
        results: Results of the command as JSON texts; ``directory`` is where it wrote.
        folder: Folder for the results of commands.
    """
    try:
        directory = Path(read_json(str, results.get("directory", ""), "the directory"))
    except DataError:
        return []
    inside = directory.parent == folder.resolve()
    return [f"{directory.name}/{each.name}" for each in sorted(directory.glob("*.png"))] if inside else []
