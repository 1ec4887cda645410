"""One injection: a command, a fault at a moment drawn from the seed, and what came of it."""

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from bench.chaos import machine
from bench.chaos.command import Command, Outcome
from bench.chaos.faults import KINDS, ROLES, Fault
from bench.chaos.hosts import Host
from bench.chaos.records import Result, Verdict
from bench.chaos.safety import Watch
from im_core import clock
from im_core.errors import ImError

#: A command that has not ended so long after its fault hangs [s]: longest wait of the machine's own, with margin.
HANG_S = 240.0
#: How long the machine may need until a command succeeds again [s] before that counts as not recovered.
RECOVERY_S = 60.0
#: What fails with a process: words of which a true reason has one.
SAYS = {
    "servo": ("servo", "mcs", "testbed"),
    "physics": ("physics", "testbed", "servo"),
    "testbed": ("testbed", "physics", "servo"),
    "mcs": ("mcs", "servo"),
    "cameras": ("camera", "vss", "exposure"),
    "vss": ("vss", "vision", "camera"),
    "bootstrap": ("bootstrap",),
}


#: What is quoted or listed in a reason, such as a data object's name, says nothing of who failed.
_QUOTED = re.compile(r"'[^']*'|\(known: .*")


@dataclass(frozen=True)
class Setting:
    """What all injections of a run share.

    Attributes:
        poses: Poses of the command.
        steps: Lines of progress of an undisturbed command.
        duration_s: Of an undisturbed command, wall time [s].
        factor: Clock factor of the machine.
        kinds: Kinds to draw from.
        among: Roles to draw from.
        files: Files in shared memory that are there between commands.
    """

    poses: Path
    steps: int
    duration_s: float
    factor: float = 0.0
    kinds: tuple[str, ...] = tuple(KINDS)
    among: tuple[str, ...] = ROLES
    files: frozenset[str] = field(default_factory=frozenset)


def run(seed: int, setting: Setting, watch: Watch) -> Result:
    """One injection, and the recovery from it."""
    draw = Random(seed)
    fault = KINDS[draw.choice(setting.kinds)](draw, setting.among)
    verdict, said, recovery_s = _throw(fault, draw, setting, watch)
    return Result(seed, setting.factor, fault.kind, str(fault), verdict, said, recovery_s)


def _throw(fault: Fault, draw: Random, setting: Setting, watch: Watch) -> tuple[Verdict, str, float | None]:
    """Verdict, what was said, and the time of recovery [s]."""
    step, later_s = draw.randrange(setting.steps), draw.uniform(0.0, 0.5)
    command = Command(setting.poses)
    command.await_step(step, HANG_S)
    clock.sleep(later_s)
    watch.take_findings()
    try:
        fault.inject(watch.expect_rest)
    except ImError as error:
        command.outcome(HANG_S)
        return Verdict.LOST, error.message, None
    injected = clock.monotonic()
    outcome = command.outcome(HANG_S)
    again, tries = next_success(setting.poses)
    if again is None:
        return Verdict.LOST, f"{outcome.said} / then {tries[-1]}", None
    recovery_s = max(0.0, again.ended - max(injected, outcome.ended) - setting.duration_s)
    beside = {role for victim in fault.victims for role in machine.sharing(victim)}
    verdict, said = judge(fault, outcome, beside), "; then: ".join([outcome.said, *tries])
    if unsafe := watch.take_findings():
        verdict, said = Verdict.UNSAFE, f"{unsafe[0]} ({len(unsafe)} such readings)"
    elif not verdict.failure and (left := leftovers(setting)):
        verdict, said = Verdict.LEFTOVER, left
    return verdict, said, recovery_s


def judge(fault: Fault, outcome: Outcome, beside: Collection[str] = ()) -> Verdict:
    """Whether the end of a command was true.

    Args:
        fault: What was done.
        outcome: The end.
        beside: Who shares a process with a victim, and fails with it.
    """
    if outcome.code is None:
        return Verdict.HANG
    if outcome.success:
        return Verdict.SUCCESS if plausible(outcome.report) else Verdict.FALSE
    words = [*fault.words, *(word for victim in {*fault.victims, *beside} for word in SAYS.get(victim, (victim,)))]
    said = _QUOTED.sub("", outcome.said.lower())
    return Verdict.TRUE_REASON if any(word in said for word in words) else Verdict.FALSE


def leftovers(setting: Setting) -> str:
    """What should not be there between commands, as a sentence; empty if nothing."""
    doubled = [role for role, processes in machine.roles().items() if len(processes) > 1]
    if doubled:
        return f"more than one process: {', '.join(doubled)}"
    missing = [role for role in ROLES if role not in machine.roles()]
    if missing:
        return f"no process: {', '.join(missing)}"
    files = machine.shared_files() - setting.files
    return f"left in /dev/shm: {', '.join(sorted(files))}" if files else ""


def next_success(poses: Path, host: Host | None = None) -> tuple[Outcome | None, list[str]]:
    """The next command that succeeds, and what those before it said; arguments as of :class:`Command`."""
    said: list[str] = []
    deadline = clock.monotonic() + RECOVERY_S
    while True:
        outcome = Command(poses, host=host).outcome(HANG_S)
        if outcome.success:
            return outcome, said
        said.append(outcome.said)
        if clock.monotonic() > deadline:
            return None, said
        clock.sleep(1.0)


def plausible(report: dict[str, object]) -> bool:
    """Whether the residuals of a report are those of noise; a calibration from mixed-up data fits badly."""
    chi2 = report.get("chi2_per_dof")
    return isinstance(chi2, float) and 0.05 < chi2 < 3.0
