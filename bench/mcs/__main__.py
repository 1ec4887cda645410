"""``python -m bench.mcs``: the figures of MCS; for ``scripts/bench.sh --mcs``."""

import argparse
import sys
from pathlib import Path

from bench.figures import measured_by_machine
from bench.mcs import durations, line, lockstep, planning, process, tick, tracking
from bench.part import Part, Work
from im_mcs.limits.configuration import load_config

GROUPS = {
    "tracking": "errors of 18 joints on moves of over 1 rad and at rest, each control law; friction and noise on",
    "line": "distance of the wrist from straight lines of 0.4 m at 0.25 m/s, commanded and measured",
    "tick": "time of one tick of the whole loop with 18 joints, and the share of each part",
    "process": "time that a control law in a process of its own adds to a tick",
    "durations": "durations of a hundred joint moves over the time-optimal ones, computed independently",
    "planning": "CPU time of searches for free paths of one arm with its cart, and of both; a check in steps of 1 mrad",
    "lockstep": "servo and physics, two processes as fast as they go: times real time",
    "deadlines": "missed deadlines in real time, at 4.5 ms and 1 ms, with ROS publishing and a camera rendering",
}

_ABOUT = """Measures the Motion Control System in the simulated testbed. Errors are those against the truth, which
only the testbed knows. Figures marked MISSED are beyond their bar; all are written as JSON into results/ too. What
else runs on the computer shows: the load average is printed before and after. "idle" means below 0.5."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("mcs", _ABOUT, GROUPS)
    part.parser.add_argument("--seed", type=int, default=1, help="of the encoder noise and the random moves (1)")
    part.parser.add_argument("--config", type=Path, help="an mcs.yaml (the shipped one)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    """What measures each group."""
    config = load_config(options.config)
    return {
        "tracking": lambda: tracking.lines(config, options.seed),
        "line": lambda: line.lines(config, options.seed),
        "tick": lambda: tick.lines(config, options.seed),
        "process": lambda: process.lines(config, options.seed),
        "durations": lambda: durations.lines(config, options.seed),
        "planning": lambda: planning.lines(config, options.seed),
        "lockstep": lambda: lockstep.lines(config, options.seed),
        "deadlines": lambda: measured_by_machine("deadlines"),
    }


if __name__ == "__main__":
    sys.exit(main())
