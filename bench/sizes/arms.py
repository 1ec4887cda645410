"""A tick of servo and physics while one arm moves, and while both do."""

import numpy as np
from numpy.typing import NDArray

from bench.figures import Line
from bench.mcs.machine import Machine, machine
from bench.mcs.rig import START, WAY
from bench.usage import cpu_s
from im_mcs.limits.configuration import McsConfig

_ONE, _BOTH = "left", "testbed"


def lines(config: McsConfig, moves: int) -> list[Line]:
    """CPU time of a tick, by process; the two arms are a group of 18 joints.

    Args:
        config: Of MCS.
        moves: How often there and back.

    Raises:
        ImError: A process does not start, or a move fails.
    """
    nine = len(START) // 2
    with machine(config.with_preset("2x9"), 0.0, 1) as running:
        one = _tick_ms(running, _ONE, START[:nine], WAY[:nine], moves)
    with machine(config.with_preset("1x18"), 0.0, 1) as running:
        both = _tick_ms(running, _BOTH, START, WAY, moves)
    return [
        Line(f"tick while both arms move, CPU of {name}", both[name], "ms", one[name], "one arm moves") for name in one
    ]


def _tick_ms(
    running: Machine, group: str, start: NDArray[np.float64], way: NDArray[np.float64], moves: int
) -> dict[str, float]:
    running.to_motion(group)
    running.move(group, start)
    before, tick = {name: cpu_s(pid) for name, pid in running.pids.items()}, running.link.tick
    for _ in range(moves):
        running.move(group, start + way)
        running.move(group, start)
    ticks = running.link.tick - tick
    return {name: 1e3 * (cpu_s(pid) - before[name]) / ticks for name, pid in running.pids.items()}
