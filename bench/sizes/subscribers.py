"""Firings of a node that nobody hears, and that many do."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from bench.figures import Line
from bench.nets.workers import number, own
from bench.sizes.growth import growth

_MODULE = "bench.nets.nodes.firing"
_START_S = 600.0
"""How long so many processes may take to start on a busy computer [s]."""


def lines(sizes: Sequence[int], firings: int, folder: Path) -> list[Line]:
    """CPU time of a firing with guard, action and journal; each subscriber is a process, as a display is.

    Raises:
        LinkError: A process fails.
    """
    used = {}
    for count in sizes:
        print(f"bench: {count} subscribers", flush=True)
        place = folder / f"subscribers_{count}"
        place.mkdir()
        with ExitStack() as stack:
            node = stack.enter_context(own(_MODULE, "fire", str(place)))
            shown = [stack.enter_context(own(_MODULE, "show", str(place))) for _ in range(count)]
            for each in shown:
                each.ask("heard", patience=_START_S)
            node.ask("ready", patience=_START_S, subscribers=count)
            node.ask("fire", firings=firings // 10)
            answer = node.ask("fire", firings=firings)
        used[count] = 1e6 * number(answer, "cpu_s") / number(answer, "firings")
    return growth("firing of a node, CPU", used, "us", "subscribers", linear=False)
