"""``python -m bench.mcs``: the figures of MCS; for ``scripts/bench.sh --mcs``."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from bench.figures import Line, measure, measured_by_machine, report
from bench.mcs import durations, line, lockstep, process, tick, tracking
from im_core.errors import ImError
from im_mcs.limits.configuration import McsConfig, load_config

PARTS = {
    "tracking": "errors of 18 joints on moves of over 1 rad and at rest, each control law; friction and noise on",
    "line": "distance of the wrist from straight lines of 0.4 m at 0.25 m/s, commanded and measured",
    "tick": "time of one tick of the whole loop with 18 joints, and the share of each part",
    "process": "time that a control law in a process of its own adds to a tick",
    "durations": "durations of a hundred joint moves over the time-optimal ones, computed independently",
    "lockstep": "servo and physics, two processes as fast as they go: times real time",
    "deadlines": "missed deadlines in real time, at 4.5 ms and 1 ms, with ROS publishing and a camera rendering",
}

_DESCRIPTION = """Measures the Motion Control System in the simulated testbed. Errors are those against the truth, which
only the testbed knows. Figures marked MISSED are beyond their bar; all are written as JSON into results/ too. What
else runs on the computer shows: the load average is printed before and after. "idle" means below 0.5.

parts:
""" + "\n".join(f"  {name:10} {what}" for name, what in PARTS.items())


def main() -> int:
    """Run the command.

    Returns:
        Exit code: 0 all bars are met, 1 a bar is missed or a measurement failed, 2 bad usage, 130 interrupted.
    """
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="bench --mcs", description=_DESCRIPTION, formatter_class=raw)
    parser.add_argument("parts", nargs="*", metavar="PART", help="only these (all)")
    parser.add_argument("--seed", type=int, default=1, help="of the encoder noise and the random moves (1)")
    parser.add_argument("--config", type=Path, help="an mcs.yaml (the shipped one)")
    options = parser.parse_args()
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"there is no part '{unknown[0]}'; there are {', '.join(PARTS)}")
    try:
        lines, failed = measure(_work(load_config(options.config), options), options.parts or list(PARTS))
    except ImError as error:
        print(f"bench: {error.message}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return 130
    return 0 if report("bench-mcs", lines) and not failed else 1


def _work(config: McsConfig, options: argparse.Namespace) -> dict[str, Callable[[], list[Line]]]:
    """What measures each part."""
    return {
        "tracking": lambda: tracking.lines(config, options.seed),
        "line": lambda: line.lines(config, options.seed),
        "tick": lambda: tick.lines(config, options.seed),
        "process": lambda: process.lines(config, options.seed),
        "durations": lambda: durations.lines(config, options.seed),
        "lockstep": lambda: lockstep.lines(config, options.seed),
        "deadlines": lambda: measured_by_machine("--deadlines"),
    }


if __name__ == "__main__":
    sys.exit(main())
