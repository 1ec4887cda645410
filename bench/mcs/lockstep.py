"""How many times faster than real time servo and physics go together, two processes in lockstep."""

from bench.figures import Line
from bench.mcs.machine import machine
from bench.mcs.rig import START, WAY
from bench.usage import cpu_s
from im_core import clock
from im_mcs.limits.configuration import McsConfig

_MOVES = 6
_BAR = 12.0


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Simulated over wall time while 18 joints move under full control, limits and collision on."""
    config = config.with_preset("1x18")
    with machine(config, 0.0, seed) as running:
        running.to_motion("testbed")
        targets = [START + WAY, START] * (_MOVES // 2)
        running.move("testbed", START)
        used = {name: cpu_s(pid) for name, pid in running.pids.items()}
        began, tick = clock.monotonic(), running.link.tick
        for target in targets:
            running.move("testbed", target)
        wall_s = clock.monotonic() - began
        ticks = running.link.tick - tick
        simulated_s = ticks * running.link.period_s
        used = {name: cpu_s(pid) - used[name] for name, pid in running.pids.items()}
    name = f"lockstep, {_MOVES} moves of 18 joints: simulated time"
    return [
        Line(name, simulated_s, "s", wall_s, "wall time", bar=_BAR, at_least=True),
        *(
            Line(f"  CPU time of {name}, a tick", 1e3 * s / ticks, "ms", 1e3 * wall_s / ticks, "wall")
            for name, s in used.items()
        ),
    ]
