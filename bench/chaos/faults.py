"""What is done to the machine: faults by kind, each drawn from a seed."""

import signal
from collections.abc import Callable, Mapping
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
#: How often each is drawn: most is learnt where a wait of the machine ends or does not.
_STOP_WEIGHTS = (2, 3, 1)
#: Who keeps a journal, and who writes files.
JOURNALS = (
    "dispatcher", "motion_coordinator", "vision_coordinator", "path_planning_coordinator", "gripper_coordinator",
)  # fmt: skip
WRITERS = (*JOURNALS, "dom", "vss", "mcs")
JUMPS_H = (-1, 1, 100_000)
#: How often all processes stand still at once, as on a computer whose host is busy, and for how long at most [s].
STANDSTILLS, LONGEST_STANDSTILL_S = 10, 1.5


@dataclass(frozen=True)
class Fault:
    """One thing that is done.

    Attributes:
        kind: Its kind, a row of the table.
        victims: Roles it is done to; what a failed command must name, one of them or what fails with them.
        inject: Does it, and undoes what is to be undone. It calls its argument where an arm that moves must come to
            rest from then on.
        words: What a true reason may say instead of a name.
    """

    kind: str
    victims: tuple[str, ...]
    inject: Callable[[Callable[[], None]], None]
    words: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.kind} {' and '.join(self.victims)}".rstrip()


def _signal(victims: tuple[str, ...], number: signal.Signals) -> list[int]:
    pids = [machine.pid_of(victim) for victim in victims]
    machine.send(number, pids)
    return pids


def kill(victims: tuple[str, ...]) -> Fault:
    """``kill -9``."""

    def inject(motion_lost: Callable[[], None]) -> None:
        _signal(victims, signal.SIGKILL)
        if {"servo", "mcs"} & set(victims):
            motion_lost()

    return Fault("kill -9" if len(victims) == 1 else "kill -9 of two", victims, inject)


def stop(victims: tuple[str, ...], seconds: float) -> Fault:
    """SIGSTOP, and SIGCONT after a while."""

    def inject(motion_lost: Callable[[], None]) -> None:
        pids = _signal(victims, signal.SIGSTOP)
        if "servo" in victims and seconds > STOPS_S[0]:
            motion_lost()
        clock.sleep(seconds)
        machine.send(signal.SIGCONT, pids)

    return Fault(f"SIGSTOP {seconds:g} s", victims, inject)


def _malformed(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("malformed messages", (), lambda _: outside.send_malformed())


def _clock_jump(draw: Random, among: tuple[str, ...]) -> Fault:
    hours = draw.choice(JUMPS_H)
    return Fault(
        f"the clock jumps {hours} h", (), lambda _: outside.jump_clock(hours), words=("clock", "time", "older", "stamp")
    )


def _second(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("a second machine", (), lambda _: outside.start_second())


def _load(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("load", (), lambda _: outside.burn(), words=("deadlines",))


def _standstill(draw: Random, among: tuple[str, ...]) -> Fault:
    pauses = [(draw.uniform(0.0, 1.0), draw.uniform(0.05, LONGEST_STANDSTILL_S)) for _ in range(STANDSTILLS)]
    words = ("deadlines", "has not ticked", "heartbeat")
    return Fault("all stands still", (), lambda _: outside.stand_still(pauses), words)


def _disk(draw: Random, among: tuple[str, ...]) -> Fault:
    role = draw.choice([role for role in WRITERS if role in among] or WRITERS)
    return Fault("full disk", (role,), lambda _: outside.fill_disk(role), words=("too large", "journal"))


def _journal(draw: Random, among: tuple[str, ...]) -> Fault:
    role = draw.choice([role for role in JOURNALS if role in among] or JOURNALS)
    return Fault("damaged journal", (role,), lambda _: outside.damage_journal(role, draw), words=("journal", "doubt"))


def _lifecycle(draw: Random, among: tuple[str, ...]) -> Fault:
    return Fault("lifecycle shutdown", ("mcs",), outside.shut_mcs_down, words=("finalized",))


#: How a fault of each kind is drawn.
KINDS: Mapping[str, Callable[[Random, tuple[str, ...]], Fault]] = {
    "kill": lambda draw, among: kill((draw.choice(among),)),
    "kill-two": lambda draw, among: kill(tuple(draw.sample(among, min(2, len(among))))),
    "stop": lambda draw, among: stop((draw.choice(among),), draw.choices(STOPS_S, _STOP_WEIGHTS)[0]),
    "malformed": _malformed,
    "clock": _clock_jump,
    "second": _second,
    "load": _load,
    "standstill": _standstill,
    "disk": _disk,
    "journal": _journal,
    "lifecycle": _lifecycle,
}
