"""What is done to the machine: faults by kind, each drawn from a seed."""

import os
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from bench.chaos import machine
from im_core import clock
from im_core.errors import StateError

#: Who can be killed and stopped.
ROLES = (
    "servo", "physics", "mcs", "testbed", "cameras", "vss", "dom", "dispatcher", "motion_coordinator",
    "vision_coordinator", "path_planning_coordinator", "gripper_coordinator", "pnt_display", "bootstrap",
)  # fmt: skip
STOPS_S = (1.0, 15.0, 60.0)
_APPEARANCE_S = 60.0


@dataclass(frozen=True)
class Fault:
    """One thing that is done.

    Attributes:
        kind: Its kind, a row of the table.
        victims: Roles it is done to; what a failed command must name, one of them or what fails with them.
        inject: Does it, and undoes what is to be undone.
        stops_motion: Whether an arm that moves must come to rest at once.
    """

    kind: str
    victims: tuple[str, ...]
    inject: Callable[[], None]
    stops_motion: bool = False

    def __str__(self) -> str:
        return f"{self.kind} {' and '.join(self.victims)}".rstrip()


def _pid(role: str) -> int:
    process = machine.await_role(role, _APPEARANCE_S)
    if process is None:
        raise StateError(f"there is no {role}")
    return process.pid


def _signal(victims: tuple[str, ...], number: signal.Signals) -> list[int]:
    pids = [_pid(victim) for victim in victims]
    for pid in pids:
        with suppress(ProcessLookupError):  # it died with the one before it
            os.kill(pid, number)
    return pids


def kill(victims: tuple[str, ...]) -> Fault:
    """``kill -9``."""
    kind = "kill -9" if len(victims) == 1 else "kill -9 of two"
    return Fault(kind, victims, lambda: (_signal(victims, signal.SIGKILL), None)[1], _carries_motion(victims))


def stop(victims: tuple[str, ...], seconds: float) -> Fault:
    """SIGSTOP, and SIGCONT after a while."""

    def inject() -> None:
        pids = _signal(victims, signal.SIGSTOP)
        clock.sleep(seconds)
        for pid in pids:
            with suppress(ProcessLookupError):  # it was replaced meanwhile
                os.kill(pid, signal.SIGCONT)

    return Fault(f"SIGSTOP {seconds:g} s", victims, inject, _carries_motion(victims))


def _carries_motion(victims: tuple[str, ...]) -> bool:
    return bool({"servo", "physics", "mcs", "testbed"} & set(victims))


#: How a fault of each kind is drawn.
KINDS: Mapping[str, Callable[[Random, tuple[str, ...]], Fault]] = {
    "kill": lambda draw, among: kill((draw.choice(among),)),
    "kill-two": lambda draw, among: kill(tuple(draw.sample(among, min(2, len(among))))),
    "stop": lambda draw, among: stop((draw.choice(among),), draw.choice(STOPS_S)),
}
