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
