"""``soak``: the same machine for a long time; what it holds after each command, and what that makes of a week."""

import argparse
import json
import os
import sys
from collections import Counter
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions

from bench.figures import Line, table
from bench.soak.commands import Commander, Outcome
from bench.soak.samples import Sample, lines, sample
from bench.soak.samples import table as sample_table
from im_bringup.machine import leftovers, stop
from im_bringup.machine.interrupts import interrupt_once
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_core import clock
from im_core.clock import stamp_name
from im_core.errors import ImError, StateError
from im_core.files import write_whole
from im_core.names import results_dir
from im_core.ros.run import Spinner

START_S = 240.0


def soak(runs: int, minutes: float, seed: int, port: int) -> tuple[list[Sample], list[Outcome]]:
    """Start the machine, command it, look at it after each command, stop it.

    Args:
        runs: Calibrations in a row, at clock factor 0; 0: random commands in real time instead.
        minutes: For how long, with random commands.
        seed: Of the machine and of the random commands.
        port: Of the display.

    Raises:
        ImError: The machine does not start, or does not answer.
    """
    path = deployments.default_path()
    if start(deployments.load(path).with_values(0.0 if runs else 1.0, seed, port), path, START_S) != 0:
        raise StateError("the machine did not start")
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
    """Run the command."""
    parser = argparse.ArgumentParser(prog="soak", description="Does anything grow while the machine works for long?")
    parser.add_argument("--runs", type=int, default=0, help="calibrations in a row, as fast as they go (200)")
    parser.add_argument("--minutes", type=float, default=0.0, help="instead: random commands in real time for so long")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--port", type=int, default=8080)
    options = parser.parse_args()
    if options.runs < 0 or options.minutes < 0.0 or (options.runs and options.minutes):
        parser.error("either --runs N or --minutes M, above 0")
    runs = options.runs or (0 if options.minutes else 200)
    interrupt_once()
    try:
        samples, outcomes = soak(runs, options.minutes, options.seed, options.port)
    except KeyboardInterrupt:
        print("soak: interrupted", file=sys.stderr)
        return 130
    except ImError as error:
        print(f"soak: {error.message}", file=sys.stderr)
        return 1
    wrong = [outcome for outcome in outcomes if not outcome.as_it_should]
    kinds = Counter(outcome.name for outcome in outcomes)
    figures = [
        Line(f"load average after, {os.cpu_count()} CPUs", os.getloadavg()[0], ""),
        *(Line(f"{name}: how often", count, "") for name, count in sorted(kinds.items())),
        Line("commands that ended wrongly", len(wrong), "", bar=0.0),
        *lines(samples),
    ]
    print(table(figures))
    print(f"soak: {keep(figures, samples)}")
    return 0 if all(line.met is not False for line in figures) else 1


def keep(figures: list[Line], samples: list[Sample]) -> Path:
    """Write the figures and all samples into the folder of the results."""
    content = {"figures": [line.__dict__ for line in figures], "samples": sample_table(samples)}
    return write_whole(results_dir() / f"bench-soak-{stamp_name()}.json", json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
