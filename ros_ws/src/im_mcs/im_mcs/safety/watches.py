"""Watches of the testbed interface layer: what the slots say, and whether they say anything."""

import math

import numpy as np

from im_core.errors import LinkError
from im_mcs.limits import JointLimits
from im_mcs.safety.watch import Finding, Reaction, Situation


class PowerWatch:
    """The testbed cuts the power by itself."""

    def check(self, now: Situation) -> Finding | None:
        """An e-stop of the hardware is one of MCS."""
        if now.power and not now.measured.power:
            return Finding(Reaction.ESTOP, LinkError(f"the testbed cut the power at tick {now.measured.tick}"))
        return None


class BrakeWatch:
    """A brake opens, or engages, against its command.

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

    def check(self, now: Situation) -> Finding | None:
        """The first joint whose brake has contradicted its command for too long."""
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
        return Finding(Reaction.ESTOP, fault)


class ReadingWatch:
    """A joint gives no reading.

    Args:
        limits: Names of the joints.
    """

    def __init__(self, limits: JointLimits) -> None:
        self._names = limits.names

    def check(self, now: Situation) -> Finding | None:
        """Without a reading nothing can be controlled, and no distance be judged."""
        q = now.measured.q
        if math.isfinite(q.dot(q)) or np.isfinite(q).all():  # the first is sufficient, and quick
            return None
        joint = self._names[int(np.argmin(np.isfinite(q)))]
        fault = LinkError(f"{joint} gave no reading at tick {now.measured.tick}", joint=joint, tick=now.measured.tick)
        return Finding(Reaction.ESTOP, fault)


class AgeWatch:
    """A reading is old: its driver falls silent.

    Args:
        limits: Names of the joints.
        bound_s: Age that is a protective stop [s].
        estop_s: Age that is an e-stop [s].
    """

    def __init__(self, limits: JointLimits, bound_s: float, estop_s: float) -> None:
        self._names = limits.names
        self._bound_s, self._estop_s = bound_s, estop_s
        self._bounds_s = np.full(len(self._names), bound_s)

    def check(self, now: Situation) -> Finding | None:
        """Protective stop, then e-stop."""
        if 1 not in (now.measured.age_s > self._bounds_s).tobytes():
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
        return Finding(Reaction.ESTOP if estop else Reaction.PROTECTIVE_STOP, fault)
