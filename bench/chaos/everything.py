"""Everything dies at a moment drawn from a seed, and the machine is started again: does the mission go on?"""

import math
from collections.abc import Callable, Mapping
from random import Random
from typing import Any

from bench.chaos.command import Command, Outcome
from bench.chaos.records import Result, Verdict
from bench.chaos.trial import HANG_S, Setting, plausible
from bench.power.plug import Plug
from im_bringup.machine import leftovers
from im_core import clock, names, unfinished_commands

KIND, POWER = "kill -9 of everything", "loss of power"
#: How far a number may be from that of the undisturbed command, in standard deviations of the difference: the noise
#: of another incarnation of the testbed is drawn anew, and the command may do without other poses.
DEVIATIONS = 5.0
#: Longest time after which a start that goes on is killed, too [s].
LONGEST_START_S = 8.0
#: What a command says that could not go on, or was not given when its machine died: a true reason has one of them.
WORDS = ("begun anew", "doubt", "gone", "missing", "died and was restarted", "no machine runs")


def run(
    seed: int,
    setting: Setting,
    start: Callable[[], None],
    die_starting: Callable[[float], None],
    reference: Mapping[str, Any],
    plug: Plug | None = None,
) -> Result:
    """One death of everything during a command, and what became of that when the machine was there again.

    Args:
        seed: Of the moment.
        setting: As for other faults.
        start: Starts the machine, which resumes what it had not ended.
        die_starting: Begins to start it, paused, and kills all of it after a time [s]; so it goes in every second
            injection, once or several times, before the machine starts.
        reference: Report of the undisturbed command.
        plug: Is pulled, too: what the machine had not synchronised is gone.
    """
    draw = Random(seed)
    step, later_s = draw.randrange(setting.steps), draw.uniform(0.0, 0.5)
    starts_s = [draw.uniform(0.0, LONGEST_START_S) for _ in range(draw.choice((0, 0, 0, 1, 2, 3)))]
    command = Command(setting.poses)
    command.await_step(step, HANG_S)
    clock.sleep(later_s)
    leftovers.end_all()
    if plug is not None:
        plug.pull(draw)
    unfinished = unfinished_commands.noted(names.run_dir())
    told = command.outcome(HANG_S)
    for seconds in starts_s:
        die_starting(seconds)
    start()
    began = clock.monotonic()
    outcome = Command(number=unfinished[-1].number).outcome(HANG_S) if unfinished else told
    verdict = judge(outcome, reference)
    recovery_s = max(0.0, outcome.ended - began - setting.duration_s) if unfinished else 0.0
    kind = KIND if plug is None else POWER
    fault = f"{kind} at step {step}" + "".join(f", of a start after {seconds:.1f} s" for seconds in starts_s)
    return Result(seed, setting.factor, kind, fault, verdict, outcome.said, recovery_s)


def judge(outcome: Outcome, reference: Mapping[str, Any]) -> Verdict:
    """Whether a command that has outlived its machine ended with what the undisturbed one found, or a true reason."""
    if outcome.code is None:
        return Verdict.HANG
    if outcome.success:
        same = plausible(outcome.report) and distance(outcome.report, reference) <= DEVIATIONS
        return Verdict.SUCCESS if same else Verdict.FALSE
    return Verdict.TRUE_REASON if any(word in outcome.said for word in WORDS) else Verdict.FALSE


def distance(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """How far two calibrations are apart: the largest difference of a number, in its standard deviations."""
    furthest = 0.0
    for first, second in zip(one["cameras"], other["cameras"], strict=True):
        if first["name"] != second["name"]:
            return math.inf
        deviations = first["standard_deviations"], second["standard_deviations"]
        for name, value in _numbers(first).items():
            spread = math.hypot(*(each[name] for each in deviations))
            furthest = max(furthest, abs(value - _numbers(second)[name]) / spread)
    return furthest


def _numbers(camera: Mapping[str, Any]) -> dict[str, float]:
    (fx, _, cx), (_, fy, cy), _ = camera["K"]
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, **dict(zip(("k1", "k2", "p1", "p2"), camera["D"], strict=False))}
