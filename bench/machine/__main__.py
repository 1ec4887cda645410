"""``python -m bench.machine``: how fast the machine is; for ``scripts/bench.sh --machine``."""

import argparse
import sys
from pathlib import Path

from bench.machine.command import accuracy_lines, machine_lines
from bench.machine.deadlines import deadline_lines
from bench.machine.handover import MOTION, VICTIMS, handover_lines
from bench.machine.hosts import host_lines
from bench.machine.pairs import pair_lines
from bench.machine.rest import rest_lines
from bench.machine.vision import vision_lines
from bench.part import Part, Work, positive

GROUPS = {
    "command": "start, commands as fast as they go against the least they could cost, memory, stop",
    "rest": "what a start costs, and the machine at rest; how often topics are told during a command",
    "real-time": "the same with one command in real time, for the servo's period and missed deadlines",
    "accuracy": "true errors over expected ones, of one command for each of some seeds",
    "pairs": "two moves at once against the longer one alone, in simulated time",
    "handover": "hand-overs of a part from random places: how many succeed, and how far off the part is at rest",
    "handover-faults": "the same with a process killed in every tenth step, but for those of motion control",
    "handover-motion": "the same with MCS or its servo killed once in each",
    "deadlines": "missed deadlines of the servo in real time",
    "hosts": "time to READY over one, two and three hosts, and what crosses between these at rest",
    "frames": "frames a second of /vss/snap, and where the time goes",
    "services": "answers a second of each vision Service, and where the time goes",
}
USUAL = ("command", "rest")

_ABOUT = """Starts the whole machine and measures it. The limit of the command is bare physics, bare rendering and the
solver of the same poses, one after the other, measured in the same run."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("machine", _ABOUT, GROUPS, USUAL)
    add = part.parser.add_argument
    add("--runs", type=positive(int), default=2, help="commands in a row of 'command' (default: %(default)d)")
    add("--seeds", type=positive(int), default=10, help="of 'accuracy', 'pairs' and 'handover' (default: %(default)d)")
    add("--renderer", choices=("auto", "egl", "tiny"), default="auto", help="of 'frames' and 'services'")
    add("--seed", type=int, default=1, help="of the testbed (default: %(default)d)")
    add("--port", type=int, default=8080, help="of the display (default: %(default)d)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    """What measures each group."""
    seed, port = options.seed, options.port
    return {
        "command": lambda: machine_lines(0.0, seed, port, options.runs),
        "rest": lambda: rest_lines(seed, port),
        "real-time": lambda: machine_lines(1.0, seed, port, 1),
        "accuracy": lambda: accuracy_lines(options.seeds, port),
        "pairs": lambda: pair_lines(options.seeds, 0.0, port),
        "handover": lambda: handover_lines(options.seeds, port),
        "handover-faults": lambda: handover_lines(options.seeds, port, VICTIMS),
        "handover-motion": lambda: handover_lines(options.seeds, port, MOTION),
        "deadlines": lambda: deadline_lines(seed, port),
        "hosts": lambda: list(host_lines()),
        "frames": lambda: vision_lines("frames", options.renderer, seed, port),
        "services": lambda: vision_lines("services", options.renderer, seed, port),
    }


if __name__ == "__main__":
    sys.exit(main())
