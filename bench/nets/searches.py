"""Figures of analysis: markings a second of explicit search, and large spaces with their time and memory."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median

from bench.figures import Line
from bench.nets.families import by_name
from bench.nets.serving import serve
from bench.nets.workers import number, own, own_path
from im_core.clock import cpu, monotonic
from im_core.errors import ImError, StateError
from im_pnt.model.net import Net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.structure.semiflows import p_semiflows
from im_pnt_analysis.verify.problem import problem_of
from im_pnt_analysis.verify.verdict import verify

LEAST_A_SECOND = 250_000.0
MOST_PROVE_S = 5.0
KNOWN = {
    "catching_philosophers:8": 3**8,
    "kanban:2": 4_600,
    "kanban:5": 2_546_432,
    "kanban:10": 1_005_927_208,
    "catching_philosophers:20": 3**20,
}
"""Number of markings of each net that is measured."""

_SMALL = ("catching_philosophers:8", "kanban:2")
_LARGE: tuple[tuple[str, float | None], ...] = (
    ("kanban:5", 20.0),
    ("kanban:10", None),
    ("catching_philosophers:20", None),
)
"""Nets with the time that their verification may take [s]."""
_MOST_GIB = 3.0
_PATIENCE_S = 300.0
_MODULE = "bench.nets.searches"


def search(net: Net) -> tuple[int, float]:
    """Lists all markings of a net, as verification does when it has found the semiflows.

    Returns:
        Number of markings, and the CPU time of the search [s].

    Raises:
        StateError: The search did not come to an end.
    """
    problem = problem_of([net])
    bounds = p_semiflows(problem.compiled).place_bounds(problem.compiled.places, problem.initial)
    began = cpu()
    searching = Search(problem.compiled, problem.initial, bounds, kinds=problem.kinds)
    stopped = searching.run(SearchLimits(states=10_000_000, seconds=_PATIENCE_S), monotonic() + _PATIENCE_S)
    used = cpu() - began
    if stopped:
        raise StateError(f"net {net.name} was not searched to its end: {stopped}")
    return searching.found.count, used


def lines(rounds: int) -> list[Line]:
    """Explicit search of small nets, and verification of large ones, each in a process of its own.

    Args:
        rounds: How often a small net is searched; the median counts.

    Raises:
        ImError: A process fails, or finds a wrong number of markings.
    """
    found: list[Line] = []
    for name in _SMALL:
        with own(_MODULE) as worker:
            answers = [worker.ask("search", net=name) for _ in range(rounds + 1)][1:]
            whole = [worker.ask("verify", net=name) for _ in range(rounds + 1)][1:]
        for answer in (*answers, *whole):
            _check(name, answer)
        rate = median(number(answer, "states") / number(answer, "cpu_s") for answer in answers)
        found.append(Line(f"explicit search, {name}", rate, "1/s", bar=LEAST_A_SECOND, at_least=True))
        rate = median(number(answer, "states") / number(answer, "cpu_s") for answer in whole)
        found.append(Line("  with all answers of verify", rate, "1/s"))
    for name, seconds in _LARGE:
        found += _large(name, seconds)
    return found


def _large(name: str, seconds: float | None) -> list[Line]:
    with own(_MODULE) as worker:
        answer = worker.ask("verify", patience=_PATIENCE_S, net=name)
    _check(name, answer)
    used, method = number(answer, "cpu_s"), str(answer["method"])
    return [
        Line(f"verify {name}, {KNOWN[name]:,} markings", used, "s", None, method, seconds),
        Line("  most memory", number(answer, "peak_gib"), "GiB", bar=_MOST_GIB),
    ]


def _check(name: str, answer: dict[str, object]) -> None:
    if answer["states"] != KNOWN[name]:
        raise StateError(f"{name} has {KNOWN[name]} markings, and {answer['states']} were found", net=name)


def shipped_lines(files: list[Path], folder: Path) -> list[Line]:
    """``pnt verify`` of all shipped nets, as before a start: with nothing proved before, and once more.

    Args:
        files: The nets.
        folder: Where there is nothing yet.

    Raises:
        ImError: They are refused, or not proved.
    """
    command = [sys.executable, "-m", "im_pnt_analysis", "verify", "--loaded", *map(str, files)]
    environment = {**os.environ, **own_path(), "IM_CACHE_DIR": str(folder / "cache")}
    found: list[Line] = []
    for what, bar in (("", MOST_PROVE_S), (", unchanged", None)):
        began, used = monotonic(), _of_children()
        ended = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        took, used = monotonic() - began, _of_children() - used
        if ended.returncode:
            raise ImError(f"pnt verify of {len(files)} nets failed: {(ended.stderr or ended.stdout).strip()[:500]}")
        found.append(Line(f"scripts/im pnt verify, {len(files)} shipped nets{what}, CPU", used, "s", bar=bar))
        found.append(Line("  wall", took, "s"))
    return found


def _of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _verify(name: str) -> dict[str, object]:
    began = cpu()
    report = verify([by_name(name)], SearchLimits(states=10_000_000, seconds=_PATIENCE_S))
    return {
        "states": report.states,
        "cpu_s": cpu() - began,
        "method": report.methods.get("states", ""),
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def _search(name: str) -> dict[str, object]:
    states, used = search(by_name(name))
    return {"states": states, "cpu_s": used}


def main() -> None:
    """Serves ``search`` and ``verify`` (net: family and size)."""

    def of_net(work: Callable[[str], dict[str, object]]) -> Callable[[dict[str, object]], dict[str, object]]:
        return lambda request: work(str(request["net"]))

    serve({"search": of_net(_search), "verify": of_net(_verify)})


if __name__ == "__main__":
    main()
