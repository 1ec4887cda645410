"""How long a tick of the whole loop takes, and where the time goes; the parts are watched from outside."""

import multiprocessing
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.figures import Line
from bench.mcs.rig import START, WAY, Rig, rig
from im_core import clock
from im_core.processes import scheduling
from im_mcs.limits.configuration import McsConfig

_BAR_MS = 1.0
_WARM_TICKS = 50


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Mean, median and p99 of a tick in motion, and the mean of each part; in a process of the servo's own rank."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        times, real_time = pool.apply(_measure, (config.with_preset("1x18"), seed))
    whole = 1e3 * np.array(times.pop("tick"))
    name = f"tick of 18 joints in motion{', SCHED_FIFO' if real_time else ''}"
    found = [
        Line(f"{name}: p99", float(np.percentile(whole, 99)), "ms", bar=_BAR_MS),
        Line("  p50", float(np.percentile(whole, 50)), "ms"),
        Line("  mean", float(whole.mean()), "ms"),
        Line("  max", float(whole.max()), "ms"),
    ]
    means = {part: 1e3 * sum(spent) / len(whole) for part, spent in times.items()}
    means["all else"] = whole.mean() - sum(means.values())
    for part, mean in sorted(means.items(), key=lambda item: -item[1]):
        found.append(Line(f"  {part}", float(mean), "ms", float(whole.mean()), "tick"))
    return found


def _measure(config: McsConfig, seed: int) -> tuple[dict[str, list[float]], bool]:
    """Times of the parts in each tick of motion [s], and whether SCHED_FIFO was in force."""
    present: dict[str, float] = defaultdict(float)
    times: dict[str, list[float]] = defaultdict(list)

    def keep() -> None:
        if machine.setpoint[1].any():
            for part, spent in present.items():
                times[part].append(spent)
        present.update(dict.fromkeys(present, 0.0))

    with rig(config, seed) as machine:
        real_time = scheduling.prefer(config.servo.priority, paced=False)
        machine.to_motion("testbed")
        _watch_parts(machine, present)
        for target in (START, START + WAY, START, START + WAY, START):
            machine.move("testbed", target, on_tick=keep)
    return {part: spent[_WARM_TICKS:] for part, spent in times.items()}, real_time


def _watch_parts(machine: Rig, present: dict[str, float]) -> None:
    """Put a stop watch around each part of a tick."""
    mcs: Any = machine.mcs
    group = mcs.groups["testbed"]
    for part, owner, method in (
        ("tick", mcs, "tick"),
        ("slots read", mcs._testbed, "read"),
        ("watches", mcs, "_watch"),
        ("planning", group, "plan"),
        ("planning", group, "advance"),
        ("limits of setpoints", mcs.loop._limiter, "limit"),
        ("collision", mcs._collision, "update"),
        ("gravity", mcs.control_model, "gravity"),
        ("control law", group, "command"),
        ("record", mcs.recorder, "put_row"),
        ("slots written", mcs._testbed, "write"),
    ):
        _watch(owner, method, part, present)


def _watch(owner: Any, method: str, part: str, present: dict[str, float]) -> None:
    function: Callable[..., Any] = getattr(owner, method)

    def watched(*args: Any, **kwargs: Any) -> Any:
        began = clock.monotonic()
        try:
            return function(*args, **kwargs)
        finally:
            present[part] += clock.monotonic() - began

    setattr(owner, method, watched)
