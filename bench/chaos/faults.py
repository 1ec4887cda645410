"""What is done to the machine: faults by kind, each drawn from a seed."""

import os
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from bench.chaos import machine, outside
from im_core import clock

#: Who can be killed and stopped.
ROLES = (
    "servo", "physics", "mcs", "testbed", "cameras", "vss", "dom", "dispatcher", "motion_coordinator",
    "vision_coordinator", "path_planning_coordinator", "gripper_coordinator", "pnt_display", "bootstrap",
)  # fmt: skip
STOPS_S = (1.0, 15.0, 60.0)
#: Who keeps a journal, and who writes files.
JOURNALS = (
    "dispatcher", "motion_coordinator", "vision_coordinator", "path_planning_coordinator", "gripper_coordinator",
)  # fmt: skip
WRITERS = (*JOURNALS, "dom", "vss", "mcs")
JUMPS_H = (-1, 1, 100_000)


@dataclass(frozen=True)
class Fault:
    """One thing that is done.

    Attributes:
        kind: Its kind, a row of the table.
        victims: Roles it is done to; what a failed command must name, one of them or what fails with them.
        inject: Does it, and undoes what is to be undone.
        stops_motion: Whether an arm that moves must come to rest at once.
        words: What a true reason may say instead of a name.
    """

    kind: str
    victims: tuple[str, ...]
    inject: Callable[[], None]
    stops_motion: bool = False
    words: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.kind} {' and '.join(self.victims)}".rstrip()


def _signal(victims: tuple[str, ...], number: signal.Signals) -> list[int]:
    pids = [machine.pid_of(victim) for victim in victims]
    for pid in pids:
        with suppress(ProcessLookupError):  # it died with the one before it
            os.kill(pid, number)
    return pids


def kill(victims: tuple[str, ...]) -> Fault:
    """``kill -9``."""

    def inject() -> None:
        _signal(victims, signal.SIGKILL)

    kind = "kill -9" if len(victims) == 1 else "kill -9 of two"
    return Fault(kind, victims, inject, bool({"servo", "mcs"} & set(victims)))


def stop(victims: tuple[str, ...], seconds: float) -> Fault:
    """SIGSTOP, and SIGCONT after a while."""

    def inject() -> None:
        pids = _signal(victims, signal.SIGSTOP)
        clock.sleep(seconds)
        for pid in pids:
            with suppress(ProcessLookupError):  # it was replaced meanwhile
                os.kill(pid, signal.SIGCONT)

    return Fault(f"SIGSTOP {seconds:g} s", victims, inject, "servo" in victims and seconds > STOPS_S[0])


def _malformed(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("malformed messages", (), outside.send_malformed)


def _clock_jump(draw: Random, among: tuple[str, ...]) -> Fault:
    hours = draw.choice(JUMPS_H)
    return Fault(
        f"the clock jumps {hours} h", (), lambda: outside.jump_clock(hours), words=("clock", "time", "older", "stamp")
    )


def _second(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("a second machine", (), outside.start_second)


def _load(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("load", (), outside.burn)


def _disk(draw: Random, among: tuple[str, ...]) -> Fault:
    role = draw.choice([role for role in WRITERS if role in among] or WRITERS)
    return Fault("full disk", (role,), lambda: outside.fill_disk(role), words=("too large", "journal"))


def _journal(draw: Random, among: tuple[str, ...]) -> Fault:
    role = draw.choice([role for role in JOURNALS if role in among] or JOURNALS)
    return Fault("damaged journal", (role,), lambda: outside.damage_journal(role, draw), words=("journal", "doubt"))


#: How a fault of each kind is drawn.
KINDS: Mapping[str, Callable[[Random, tuple[str, ...]], Fault]] = {
    "kill": lambda draw, among: kill((draw.choice(among),)),
    "kill-two": lambda draw, among: kill(tuple(draw.sample(among, min(2, len(among))))),
    "stop": lambda draw, among: stop((draw.choice(among),), draw.choice(STOPS_S)),
    "malformed": _malformed,
    "clock": _clock_jump,
    "second": _second,
    "load": _load,
    "disk": _disk,
    "journal": _journal,
}
