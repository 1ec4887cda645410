"""``soak``: the same machine for a long time; what it holds after each command, and what that makes of a week."""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions

from bench.figures import Line
from bench.part import Part, Work, positive
from bench.soak.commands import Commander, Outcome
from bench.soak.samples import Sample, lines, sample
from bench.soak.samples import table as sample_table
from im_bringup.machine import leftovers, stop
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_core import clock
from im_core.clock import stamp_name
from im_core.errors import StateError
from im_core.files import write_whole
from im_core.names import results_dir
from im_core.ros.run import Spinner

START_S = 240.0
GROUPS = {
    "commands": "calibrations in a row, as fast as they go",
    "random": "random commands in real time",
}
USUAL = ("commands",)

_ABOUT = "Does anything grow while the machine works for long? What it holds after each command, and of that a week."


def soak(runs: int, minutes: float, seed: int, port: int) -> tuple[list[Sample], list[Outcome]]:
    """Start the machine, command it, look at it after each command, stop it.

    Args:
        runs: Calibrations in a row, at clock factor 0; 0: random commands in real time instead.
        minutes: For how long, with random commands.
        seed: Of the machine and of the random commands.
        port: Of the display.

    Returns:
        The samples and how the commands ended; the samples so far are in a file of the results at any time.

    Raises:
        ImError: The machine does not start, or does not answer.
    """
    path = deployments.default_path()
    deployment = deployments.load(path).with_values(clock_factor=0.0 if runs else 1.0, seed=seed, port=port)
    if start(deployment, path, START_S) != 0:
        raise StateError("the machine did not start")
    kept = results_dir() / f"soak-samples-{stamp_name()}.json"
    print(f"soak: samples in {kept}", flush=True)
    samples: list[Sample] = []
    outcomes: list[Outcome] = []
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        commander = Commander(seed)
        with Spinner([commander]):
            began = clock.monotonic()
            while len(outcomes) < runs if runs else clock.monotonic() - began < 60.0 * minutes:
                outcome = commander.whole_calibration() if runs else commander.any_command()
                outcomes.append(outcome)
                pids = [process.pid for process in leftovers.processes()]
                samples.append(sample(pids, outcome.name, clock.monotonic() - began, outcome.duration_s))
                write_whole(kept, json.dumps(sample_table(samples), indent=1))
                told = "" if outcome.as_it_should else f" ENDED WRONGLY: {outcome.message}"
                print(
                    f"soak: {len(outcomes)}: {outcome.name}, {outcome.duration_s:.1f} s, "
                    f"{samples[-1].memory:.0f} MiB{told}",
                    flush=True,
                )
    finally:
        rclpy.try_shutdown()
        stop.stop(say=lambda _: None)
    return samples, outcomes


def main() -> int:
    """Run the command; its exit code."""
    part = Part("soak", _ABOUT, GROUPS, USUAL)
    add = part.parser.add_argument
    add("--runs", type=positive(int), default=200, help="calibrations in a row (default: %(default)d)")
    add("--minutes", type=positive(float), default=60.0, help="of random commands (default: %(default)g)")
    add("--seed", type=int, default=1, help="of the machine and of the random commands (default: %(default)d)")
    add("--port", type=int, default=8080, help="of the display (default: %(default)d)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    """What measures each group."""
    return {
        "commands": lambda: judged(*soak(options.runs, 0.0, options.seed, options.port)),
        "random": lambda: judged(*soak(0, options.minutes, options.seed, options.port)),
    }


def judged(samples: list[Sample], outcomes: list[Outcome]) -> list[Line]:
    """The figures."""
    wrong = [outcome for outcome in outcomes if not outcome.as_it_should]
    kinds = Counter(outcome.name for outcome in outcomes)
    return [
        *(Line(f"{name}: how often", count, "") for name, count in sorted(kinds.items())),
        Line("commands that ended wrongly", len(wrong), "", bar=0.0),
        *lines(samples),
    ]


if __name__ == "__main__":
    sys.exit(main())
