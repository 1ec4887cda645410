"""Times of transitions in PNML as delays, weights and priorities of ours.

Of stochastic nets (PIPE, GreatSPN; Ajmone Marsan, Balbo, Conte, 1984) a timed transition has an exponential ``delay``;
an immediate one has none, and its rate is its ``weight``. Infinite servers of a timed transition are our ``servers:
inf``. Of time Petri nets (Merlin, 1974; TINA) only ``[a,a]`` has a meaning here: a transition without a delay fires at
once, and so none may wait as long as it likes while others are timed. TAPAAL's urgent transitions are those: no time
passes while one is enabled.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from im_core.errors import quoted_text
from im_pnt.model.net import LARGEST
from im_pnt.pnml.element import Element
from im_pnt.pnml.label import (
    TimeInterval,
    find_label,
    label_count,
    label_flag,
    label_interval,
    label_number,
    label_text,
)

_STOCHASTIC = "StochasticPetriNet"
_KEYS = ("distributionType", "distributionParameters", "weight", "priority", "invisible", "trainingData")
"""Keys of a transition there; trainingData are the observed times that a distribution was fitted to."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Time of a transition.

    Attributes:
        rate: Firings in a second while it is enabled [1/s]; None: it is immediate, or of a net without time.
        interval: Times for which it must be enabled [s]; None: not said.
        weight: How often it is taken among contending immediate transitions, relative to the others.
        priority: Larger goes first among immediate transitions.
        infinite: Whether the time of a timed transition runs for each of its tokens.
    """

    element: Element
    rate: float | None = None
    interval: TimeInterval | None = None
    weight: float = 1.0
    priority: int = 0
    infinite: bool = False


def timing_of(transition: Element) -> Timing:
    """Return what a transition says of its time.

    Raises:
        NetFileError: It cannot be read, or has no meaning here.
    """
    rate, timed = label_number(transition, "rate"), label_flag(transition, "timed")
    weight = label_number(transition, "weight") or 1.0
    priority = label_count(transition, "priority", 0, 0).number
    interval = label_interval(transition, "delay")
    label_flag(transition, "urgent")
    if (label_text(transition, "player") or "0") != "0":
        raise transition.error("belongs to the environment of a game (player); allowed is 0")
    if timed is None:
        timed = rate is not None
    if timed and rate is None:
        raise transition.error("is timed, and says no 'rate'")
    infinite = label_flag(transition, "infiniteServer") is True
    if interval is not None and not interval.is_any:
        if timed:
            raise transition.error(f"has both the rate {rate:g} and the interval {interval.shown}; one is allowed")
        if interval.low != interval.high or interval.shown[0] != "[" or interval.shown[-1] != "]":
            sentence = f"{quoted_text(interval.shown)} leaves the time open; allowed are [a,a] and [0,inf)"
            raise (find_label(transition, "delay") or transition).error(sentence)
    for tool in transition.all("toolspecific"):
        if tool.attributes.get("tool") == _STOCHASTIC:
            weight, priority = _stochastic(tool)
    if timed:
        return Timing(transition, rate, infinite=infinite)
    return Timing(transition, None, interval, weight * (rate or 1.0), priority)


def timing_keys(timings: Iterable[Timing]) -> list[dict[str, object]]:
    """Return the keys of our net files for the times of all transitions of a net.

    Raises:
        NetFileError: A transition may wait as long as it likes, while others are timed.
    """
    found = list(timings)
    timed = next((each for each in found if each.interval is not None and not each.interval.is_any), None)
    lowest = min((each.priority for each in found if each.rate is None), default=0)
    keys = []
    for each in found:
        if timed is not None and (each.interval is None or each.interval.is_any):
            name = timed.element.attributes.get("id", "")
            sentence = f"may wait as long as it likes, while '{name[:60]}' waits for a given time; allowed is [a,a]"
            raise each.element.error(sentence)
        delay: object = None if each.rate is None else {"exponential": {"rate": each.rate}}
        if each.interval is not None and each.interval.low > 0.0:
            delay = each.interval.low
        weight = None if each.weight == 1.0 else each.weight
        priority = None if each.rate is not None else each.priority - lowest
        servers = "inf" if each.infinite else None
        keys.append({"delay": delay, "weight": weight, "priority": priority, "servers": servers})
    return keys


def _stochastic(tool: Element) -> tuple[float, int]:
    """Return weight and priority of a transition of pm4py and ProM."""
    said: dict[str, str] = {}
    for entry in tool.children:
        key = entry.attributes.get("key", "")
        if entry.tag != "property" or key not in _KEYS or key in said:
            raise entry.error(f"{quoted_text(key)} is not understood in toolspecific of {_STOCHASTIC}, or there twice")
        said[key] = entry.text.strip()
    kind = said.get("distributionType", "IMMEDIATE")
    if kind not in ("IMMEDIATE", "UNDEFINED"):
        sentence = f"distribution {quoted_text(kind)} is not understood, as tools differ in its parameters; allowed are"
        raise tool.error(f"{sentence} IMMEDIATE and UNDEFINED")
    try:
        weight, priority = float(said.get("weight", "1")), int(said.get("priority", "0"))
    except ValueError as error:
        raise tool.error(f"weight or priority is no number: {error}") from error
    if not (0.0 < weight < float("inf") and 0 <= priority <= LARGEST):
        raise tool.error(f"weight {weight:g} must be > 0, and priority {priority} a whole number from 0")
    return weight, priority
