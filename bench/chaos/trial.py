"""One injection: a command, a fault at a moment drawn from the seed, and what came of it."""

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from random import Random

from bench.chaos import machine
from bench.chaos.command import Command, Outcome
from bench.chaos.faults import KINDS, ROLES, Fault
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


class Verdict(Enum):
    """What an injection came to."""

    SUCCESS = "success"
    TRUE_REASON = "true reason"
    FALSE = "FALSE"
    HANG = "HANG"
    UNSAFE = "UNSAFE"
    LEFTOVER = "LEFTOVER"
    LOST = "NOT RECOVERED"

    @property
    def failure(self) -> bool:
        """Whether the bench fails with it."""
        return self not in (Verdict.SUCCESS, Verdict.TRUE_REASON)


@dataclass(frozen=True)
class Result:
    """What came of an injection.

    Attributes:
        seed: Repeats it.
        fault: What was done.
        verdict: What it came to.
        said: What the command said, and what else was found.
        recovery_s: From the end of fault and command to the next success, less the duration of a command [s].
    """

    seed: int
    fault: Fault
    verdict: Verdict
    said: str
    recovery_s: float | None


@dataclass(frozen=True)
class Setting:
    """What all injections of a run share.

    Attributes:
        poses: Poses of the command.
        steps: Lines of progress of an undisturbed command.
        duration_s: Of an undisturbed command, wall time [s].
        kinds: Kinds to draw from.
        among: Roles to draw from.
        files: Files in shared memory that are there between commands.
    """

    poses: Path
    steps: int
    duration_s: float
    kinds: tuple[str, ...] = tuple(KINDS)
    among: tuple[str, ...] = ROLES
    files: frozenset[str] = field(default_factory=frozenset)


def run(seed: int, setting: Setting, watch: Watch) -> Result:
    """One injection, and the recovery from it."""
    draw = Random(seed)
    fault = KINDS[draw.choice(setting.kinds)](draw, setting.among)
    step, later_s = draw.randrange(setting.steps), draw.uniform(0.0, 0.5)
    command = Command(setting.poses)
    command.await_step(step, HANG_S)
    clock.sleep(later_s)
    watch.take_findings()
    if fault.stops_motion:
        watch.expect_rest()
    try:
        fault.inject()
    except ImError as error:
        command.outcome(HANG_S)
        return Result(seed, fault, Verdict.LOST, error.message, None)
    injected = clock.monotonic()
    outcome = command.outcome(HANG_S)
    verdict = judge(fault, outcome)
    unsafe = watch.take_findings()
    again, tries = _again(setting)
    if again is None:
        return Result(seed, fault, Verdict.LOST, f"{outcome.said} / then {tries[-1]}", None)
    recovery_s = max(0.0, again.ended - max(injected, outcome.ended) - setting.duration_s)
    unsafe += watch.take_findings()
    if unsafe:
        return Result(seed, fault, Verdict.UNSAFE, f"{unsafe[0]} ({len(unsafe)} such readings)", recovery_s)
    left = leftovers(setting)
    if left and not verdict.failure:
        return Result(seed, fault, Verdict.LEFTOVER, left, recovery_s)
    return Result(seed, fault, verdict, "; then: ".join([outcome.said, *tries]), recovery_s)


def judge(fault: Fault, outcome: Outcome) -> Verdict:
    """Whether the end of a command was true."""
    if outcome.code is None:
        return Verdict.HANG
    if outcome.success:
        return Verdict.SUCCESS if _plausible(outcome.report) else Verdict.FALSE
    words = [*fault.words, *(word for victim in fault.victims for word in SAYS.get(victim, (victim,)))]
    said = outcome.said.lower()
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


def _again(setting: Setting) -> tuple[Outcome | None, list[str]]:
    """The next command that succeeds, and what those before it said."""
    said: list[str] = []
    deadline = clock.monotonic() + RECOVERY_S
    while True:
        outcome = Command(setting.poses).outcome(HANG_S)
        if outcome.success:
            return outcome, said
        said.append(outcome.said)
        if clock.monotonic() > deadline:
            return None, said
        clock.sleep(1.0)


def _plausible(report: dict[str, object]) -> bool:
    """Whether the residuals of a report are those of noise; a calibration from mixed-up data fits badly."""
    chi2 = report.get("chi2_per_dof")
    return isinstance(chi2, float) and 0.05 < chi2 < 3.0
