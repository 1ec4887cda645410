"""Watches: each checks one possible fault in every tick with power on; the supervisor runs all watches."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, LinkError, StateError
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.vectors import all_finite, any_beyond
from im_mcs.model.dynamics import Place
from im_mcs.state.reservation import Reservations
from im_mcs.testbed.driver import Measured

# of the bound of the following error that is an e-stop
ESTOP_FACTOR = 2.0


class Reaction(Enum):
    """Reaction to a finding."""

    END = "end"
    """Decelerate on the path and hold; the goals end with the fault."""
    PROTECTIVE_STOP = "protective stop"
    """Decelerate on the path and hold; the goals are suspended until ``resume``."""
    ESTOP = "emergency stop"
    """In the same tick: no setpoint, no torque, brakes on, power off."""


@dataclass(frozen=True)
class SafetyFinding:
    """Finding of a watch.

    Attributes:
        reaction: What to do.
        fault: Why.
        groups: Which groups it concerns; None: all.
    """

    reaction: Reaction
    fault: ImError
    groups: tuple[str, ...] | None = None


class WatchedGroup(Protocol):
    """Group from the watches' view.

    Attributes:
        name: Name of the group.
        engaged: Whether the group has setpoints and torques.
        index: Ranks of the group's joints among all, shape (n,), and
        place: the same, quicker to read from.
    """

    name: str
    engaged: bool
    index: NDArray[np.intp]
    place: Place


@dataclass
class Situation:
    """A tick in the eyes of the watches; filled anew in every tick.

    Attributes:
        measured: What the slots say.
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        following_error: Setpoints of the times of the readings less the readings, shape (n,) [rad or m].
        power: Whether power is commanded.
        brakes: Which brakes are commanded to hold, shape (n,).
        groups: Groups of the preset in force.
        owner_silence_s: For how long the owner process has given no heartbeat, wall time [s].
        overruns: Servo deadlines missed in a row.
    """

    measured: Measured
    v: NDArray[np.float64]
    following_error: NDArray[np.float64]
    groups: Mapping[str, WatchedGroup]
    brakes: NDArray[np.bool_]
    power: bool = False
    owner_silence_s: float = 0.0
    overruns: int = 0


class Watch(Protocol):
    """Watch over one possible fault, in every tick with power on."""

    def check(self, now: Situation) -> SafetyFinding | None:
        """Return the fault, if any."""
        ...


# what the slots say, and whether they say anything


class PowerWatch:
    """Watch over the power: the testbed may cut the power without a command."""

    def __init__(self, faults: Callable[[], Sequence[str]]) -> None:
        self._faults = faults

    def check(self, now: Situation) -> SafetyFinding | None:
        """An e-stop of the hardware is one of MCS."""
        if now.power and not now.measured.power:
            told = f"the testbed cut the power at tick {now.measured.tick}"
            try:
                said = ", ".join(self._faults())
            except LinkError as error:
                said = error.message
            return SafetyFinding(Reaction.ESTOP, LinkError(f"{told}: {said}" if said else told))
        return None


class BrakeWatch:
    """Watch over brakes opening or engaging against the command.

    A joint whose brake opens by itself falls; one whose brake engages by itself works against its motor, and would
    leap once it is free. Both are an e-stop. A brake that has been told to move is given the time that the transition
    under way gives it too: what then becomes of it is the transition's to decide.

    Args:
        limits: Names of the joints.
        period_s: Servo period [s].
        answer_s: A brake that is told to move has done so after this time [s].
        bound_s: For how long a brake that was obeying may contradict its command [s].
    """

    def __init__(self, limits: JointLimits, period_s: float, answer_s: float, bound_s: float) -> None:
        self._names = limits.names
        self._bound_s = bound_s
        self._bound = round(bound_s / period_s)
        self._answer = round(answer_s / period_s) + self._bound
        self._left = np.full(len(self._names), self._bound)
        self._told = np.ones(len(self._names), dtype=np.bool_)
        self._agreed = b""

    def check(self, now: Situation) -> SafetyFinding | None:
        """Return the first joint with a brake against the command for too long."""
        told, said = now.brakes, now.measured.brakes
        if said.tobytes() == self._agreed == told.tobytes():  # comparing bytes is quick, and this is nearly every tick
            return None
        wrong = told != said
        self._left[told != self._told] = self._answer
        self._left[~wrong] = self._bound
        self._left[wrong] -= 1
        self._told = told.copy()
        self._agreed = b"" if wrong.any() else told.tobytes()
        if self._left.min() >= 0:
            return None
        rank, tick = int(self._left.argmin()), now.measured.tick
        joint = self._names[rank]
        is_so, should = ("is engaged", "be open") if said[rank] else ("is open", "hold")
        fault = LinkError(
            f"the brake of {joint} {is_so} at tick {tick} for more than {self._bound_s:g} s, though told to {should}",
            joint=joint,
            limit=self._bound_s,
            unit="s",
            tick=tick,
        )
        return SafetyFinding(Reaction.ESTOP, fault)


class ReadingWatch:
    """A joint gives no reading, or one that cannot be, as in degrees."""

    def __init__(self, limits: JointLimits) -> None:
        self._names, self._limits = limits.names, limits

    def check(self, now: Situation) -> SafetyFinding | None:
        """Without a reading nothing can be controlled, and no distance be judged."""
        q = now.measured.q
        if all_finite(q):
            impossible = self._limits.impossible(q)
            return SafetyFinding(Reaction.ESTOP, LinkError(impossible)) if impossible else None
        joint = self._names[int(np.argmin(np.isfinite(q)))]
        fault = LinkError(f"{joint} gave no reading at tick {now.measured.tick}", joint=joint, tick=now.measured.tick)
        return SafetyFinding(Reaction.ESTOP, fault)


class AgeWatch:
    """Watch over the age of readings: a driver may fall silent.

    Args:
        limits: Names of the joints.
        bound_s: Age that is a protective stop [s].
        estop_s: Age that is an e-stop [s].
    """

    def __init__(self, limits: JointLimits, bound_s: float, estop_s: float) -> None:
        self._names = limits.names
        self._bound_s, self._estop_s = bound_s, estop_s
        self._bounds_s = np.full(len(self._names), bound_s)

    def check(self, now: Situation) -> SafetyFinding | None:
        """Protective stop, then e-stop."""
        if not any_beyond(now.measured.age_s, self._bounds_s):
            return None
        oldest = float(now.measured.age_s.max())
        joint = self._names[int(np.argmax(now.measured.age_s))]
        estop = oldest > self._estop_s
        bound = self._estop_s if estop else self._bound_s
        fault = LinkError(
            f"the reading of {joint} is {oldest:.3g} s old at tick {now.measured.tick}, {bound:g} s are allowed",
            joint=joint,
            value=oldest,
            limit=bound,
            unit="s",
            tick=now.measured.tick,
        )
        return SafetyFinding(Reaction.ESTOP if estop else Reaction.PROTECTIVE_STOP, fault)


# the motion


class SpeedWatch:
    """A joint is faster than any motion commands."""

    def __init__(self, limits: JointLimits) -> None:
        self._limits = limits

    def check(self, now: Situation) -> SafetyFinding | None:
        """Return an e-stop for a speed beyond any control."""
        fault = self._limits.overspeed(now.v)
        return None if fault is None else SafetyFinding(Reaction.ESTOP, fault)


class FollowingWatch:
    """Watch over following errors: a protective stop beyond the bound, an e-stop beyond twice the bound."""

    def __init__(self, limits: JointLimits) -> None:
        self._limits = limits

    def check(self, now: Situation) -> SafetyFinding | None:
        """Return the joint furthest beyond the bound, in the first group with one."""
        for group in now.groups.values():
            if not group.engaged:
                continue
            error = now.following_error[group.place]
            if not any_beyond(error, self._limits.following_error[group.place]):
                continue
            tick = now.measured.tick
            beyond = self._limits.following(group.index, error, ESTOP_FACTOR, tick)
            if beyond is not None:
                return SafetyFinding(Reaction.ESTOP, beyond)
            fault = self._limits.following(group.index, error, 1.0, tick)
            if fault is not None:
                return SafetyFinding(Reaction.PROTECTIVE_STOP, fault, (group.name,))
        return None


# those who take part: the servo's own deadlines, the owner process, the clients with a lease


class OverrunWatch:
    """Servo deadlines were missed in a row."""

    def __init__(self, bound: int) -> None:
        self._bound = bound

    def check(self, now: Situation) -> SafetyFinding | None:
        """Count single overruns, and return a protective stop for several in a row."""
        if now.overruns < self._bound:
            return None
        told = f"{now.overruns} servo deadlines in a row were missed: this computer is too busy for the clock factor"
        fault = ImError(told, code="overrun", missed=now.overruns)
        return SafetyFinding(Reaction.PROTECTIVE_STOP, fault)


class OwnerWatch:
    """Watch over heartbeats of the servo's owner (the ``mcs`` node).

    Args:
        bound_s: Wall time without one [s].
    """

    def __init__(self, bound_s: float) -> None:
        self._bound_s = bound_s

    def check(self, now: Situation) -> SafetyFinding | None:
        """Nobody could command a stop any more: the goals end; the core then switches power off."""
        if now.owner_silence_s <= self._bound_s:
            return None
        silent = "is gone"
        if math.isfinite(now.owner_silence_s):
            silent = f"gave no heartbeat for {now.owner_silence_s:.2g} s, {self._bound_s:g} s are allowed"
        return SafetyFinding(Reaction.END, LinkError(f"the process that owns the servo {silent}"))


class LeaseWatch:
    """Watch over the leases of reserved groups."""

    def __init__(self, reservations: Reservations) -> None:
        self._reservations = reservations

    def check(self, now: Situation) -> SafetyFinding | None:
        """Return a finding for expired leases: the groups decelerate and hold, and the goals end."""
        lapsed = self._reservations.lapse(now.measured.stamp_ns)
        if not lapsed:
            return None
        first = lapsed[0]
        groups = tuple(r.group for r in lapsed if r.owner == first.owner)
        named = ", ".join(f"'{group}'" for group in groups)
        fault = StateError(
            f"the lease of owner '{first.owner}' on {named} lapsed: it was not renewed for {first.lease_s:g} s",
            owner=first.owner,
            groups=list(groups),
        )
        fault.code = "lease"
        return SafetyFinding(Reaction.END, fault, groups)


class Supervisor:
    """All watches, e-stop watches first.

    Args:
        watches: In the order in which they are asked.
    """

    def __init__(self, watches: Sequence[Watch]) -> None:
        self._watches = tuple(watches)

    @classmethod
    def make(
        cls,
        config: McsConfig,
        limits: JointLimits,
        reservations: Reservations,
        faults: Callable[[], Sequence[str]],
    ) -> "Supervisor":
        """The watches of a configuration; ``faults`` gives the faults reported by hardware."""
        safety, servo = config.safety, config.servo
        return cls(
            (
                PowerWatch(faults),
                BrakeWatch(limits, servo.period_s, servo.answer_timeout_s, safety.brake_s),
                ReadingWatch(limits),
                SpeedWatch(limits),
                AgeWatch(limits, safety.driver_age_s, safety.driver_age_estop_s),
                FollowingWatch(limits),
                LeaseWatch(reservations),
                OwnerWatch(safety.owner_silence_s),
                OverrunWatch(servo.max_overruns),
            )
        )

    def check(self, now: Situation) -> list[SafetyFinding]:
        """Return the fault of the current tick; nothing after an e-stop, which includes all."""
        findings = []
        for watch in self._watches:
            finding = watch.check(now)
            if finding is not None:
                findings.append(finding)
                if finding.reaction is Reaction.ESTOP:
                    break
        return findings
