"""Playing nets by their structure, delays and probabilities alone: on a virtual clock, with imagined actions."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from im_pnt.errors import NetError
from im_pnt.net import Net
from im_pnt.timed.model import timed_net
from im_pnt.timed.player import Player


@dataclass(frozen=True, slots=True)
class Step:
    """One firing of a simulation.

    Attributes:
        time: Virtual time [s].
        transition: What fired, by its name in the composition.
        marking: The marked places afterwards.
    """

    time: float
    transition: str
    marking: dict[str, int]


def simulate(
    nets: Sequence[Net], *, seed: int = 0, steps: int | None = 100, until: float | None = None, failures: float = 0.0
) -> Iterator[Step]:
    """Plays nets composed with their environment: symbols and callers come when the nets have nothing else to do.

    Args:
        nets: The nets.
        seed: The same seed gives the same run.
        steps: Firings at most; None: no limit.
        until: Virtual time to stop at [s]; None: no limit.
        failures: Probability that an action without ``success`` fails.

    Yields:
        Each firing; ends early where nothing can fire.

    Raises:
        NetError: The nets do not fit together, or no time passes any more.
    """
    player = Player(timed_net(nets, failures=failures), seed)
    player.until = run_limits(steps, until)
    net = player.net
    count = 0
    while (steps is None or count < steps) and (fired := player.step()) >= 0:
        count += 1
        yield Step(player.time, net.shown[fired], net.marking(player.tokens))


def run_limits(steps: int | None, until: float | None) -> float:
    """Checks where a run shall stop, and returns the time of it [s].

    Raises:
        NetError: That is no number of firings, or no time.
    """
    if steps is not None and steps < 1:
        raise NetError(f"{steps} firings cannot be played; at least 1 is needed")
    if until is None:
        return math.inf
    if not 0.0 < until < math.inf:
        raise NetError(f"a run cannot end at time {until}; a number > 0 is needed [s]")
    return until
