"""``pnt bench``: measure how fast nets fire and are searched."""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass

from im_core import plugins
from im_core.errors import ImError
from im_pnt.model.families import FAMILIES, by_name
from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_node.cli.speed import fire

_DEFAULT = ("ring:100", "philosophers:100", "catching_philosophers:8", "kanban:2")

_DESCRIPTION = f"""Fires nets as nodes do and searches their markings, and prints how fast that is, in CPU time.

  scripts/im pnt bench                                  nets whose answers are known: {", ".join(_DEFAULT)}
  scripts/im pnt bench kanban:5 ring:1000               other sizes; families are {", ".join(FAMILIES)}
  scripts/im pnt bench dispatcher.yaml motion.yaml      your nets, composed

Actions confirm at once, guards are drawn by lot, and whenever nothing can fire the tape gets every symbol. Start and
end of an action are two firings. How this compares with other libraries, scripts/bench.sh --nets tells."""


SEARCH = "im_pnt_analysis:search_speed"
"""The search of markings, of the package of the verifier."""


@dataclass(frozen=True, slots=True)
class Speed:
    """Figures of nets.

    Attributes:
        nets: Names of the nets.
        firings: Number of firings; start and end of an action are two.
        firing_s: CPU time of the firings [s].
        states: Number of markings found.
        search_s: CPU time of the search [s].
        stopped: Reason of an early end of the search; empty where all markings were found.
    """

    nets: tuple[str, ...]
    firings: int
    firing_s: float
    states: int
    search_s: float
    stopped: str

    @property
    def firings_per_s(self) -> float | None:
        """Firings a second of CPU time; None where nothing fired."""
        return self.firings / self.firing_s if self.firings else None

    @property
    def states_per_s(self) -> float:
        """Markings a second of CPU time."""
        return self.states / max(1e-9, self.search_s)


def add(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser of ``pnt``."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = commands.add_parser("bench", help="how fast are nets?", description=_DESCRIPTION, formatter_class=raw)
    parser.set_defaults(run=run)
    parser.add_argument("nets", nargs="*", metavar="FILE", help="net files, composed; or nets of families")
    parser.add_argument("--firings", type=int, default=100_000, metavar="N", help="firings of each (100000)")
    parser.add_argument("--states", type=int, default=1_000_000, metavar="N", help="markings to search (1000000)")
    parser.add_argument("--timeout", type=float, default=30.0, metavar="S", help="CPU time of a search or run [s] (30)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="same seed, same firings (0)")
    parser.add_argument("--json", action="store_true", help="print one JSON list instead of a table")


def run(options: argparse.Namespace) -> int:
    """Measure nets.

    Raises:
        ImError: An option is out of range, or a file is wrong.
    """
    for name in ("firings", "states", "timeout"):
        if not getattr(options, name) > 0:
            raise ImError(f"--{name} {getattr(options, name)} must be larger than 0", code="input")
    names = options.nets or _DEFAULT
    families = [name for name in names if _is_family(name)]
    files = [name for name in names if not _is_family(name)]
    groups = [[by_name(name)] for name in families]
    if files:
        groups.append([load_net(file) for file in files])
    speeds = [_measured(nets, options) for nets in groups]
    print(json.dumps([_plain(speed) for speed in speeds], indent=1) if options.json else _table(speeds))
    return 0


def _measured(nets: list[Net], options: argparse.Namespace) -> Speed:
    search: Callable[[list[Net], int, float], tuple[int, float, str]]
    search = plugins.load(SEARCH, None, "search of markings")  # type: ignore[assignment]  # the function is of that type
    states, search_s, stopped = search(nets, options.states, options.timeout)
    firings, firing_s = fire(nets, options.firings, options.timeout, options.seed)
    return Speed(tuple(net.name for net in nets), firings, firing_s, states, search_s, stopped)


def _is_family(name: str) -> bool:
    return name.partition(":")[0] in FAMILIES


def _plain(speed: Speed) -> dict[str, object]:
    return {
        "nets": speed.nets,
        "firings": speed.firings,
        "firings_per_s": speed.firings_per_s,
        "states": speed.states,
        "states_per_s": speed.states_per_s,
        "search_stopped": speed.stopped or None,
    }


def _table(speeds: list[Speed]) -> str:
    names = ["+".join(speed.nets) for speed in speeds]
    width = max(len(name) for name in (*names, "net"))
    lines = [f"{'net':{width}}  {'firings/s':>12}  {'markings/s':>12}  {'markings':>12}"]
    for name, speed in zip(names, speeds, strict=True):
        firings = "-" if speed.firings_per_s is None else f"{speed.firings_per_s:,.0f}"
        line = f"{name:{width}}  {firings:>12}  {speed.states_per_s:>12,.0f}  {speed.states:>12,}"
        lines.append(f"{line}  {speed.stopped}".rstrip())
    return "\n".join(lines)
