"""Rates of a group's motions, and the causes of rates: speeds, pauses, stops."""

from collections.abc import Sequence
from dataclasses import dataclass

from im_core.errors import ImError, StateError
from im_mcs.group.goals import Current
from im_mcs.protocol.requests import SLOWEST

_CEILING_STEPS = 20
_SCALING_STEP = 0.01


@dataclass
class Rates:
    """Causes of the rate of motions.

    Attributes:
        override: Of the client, above 0 up to 1; 0 halts.
        ceiling: Of the collision monitor, above 0 up to 1.
        scaling: Of the robot itself, 0 to 1, on top of the others; 0 halts.
        paused: By the client.
        protective: Fault of a protective stop that suspends goals, and
        patience: for how long still [ticks].
        held: Fault of a protective stop that was asked for: latched until the group is resumed.
    """

    override: float = 1.0
    ceiling: float = 1.0
    scaling: float = 1.0
    paused: bool = False
    protective: ImError | None = None
    patience: int = 0
    held: ImError | None = None

    @property
    def stopped(self) -> ImError | None:
        """Fault of the protective stop in force."""
        return self.protective or self.held

    @property
    def halted(self) -> bool:
        """Whether the client has paused the group, or scaled the speed to 0."""
        return self.paused or self.override == 0.0

    def require_released(self, group: str) -> None:
        """Check whether no protective stop holds a group.

        Raises:
            StateError: One does.
        """
        if self.stopped is not None:
            end = "" if self.held is not None else ", or wait until its goals have ended"
            told = f"group '{group}' is held by a protective stop ({self.stopped.message}); resume it{end}"
            raise StateError(told, group=group)

    def of(self, current: Current | None, share: float | None = None) -> float:
        """Rate wanted of a motion."""
        halted = self.halted or self.scaling == 0.0 or self.protective is not None
        if halted or (current is not None and current.goal.fault is not None):
            return 0.0
        if share is None:
            share = 1.0 if current is None else current.share
        return min(max(self.override * share, SLOWEST), self.ceiling) * self.scaling

    def set_ceiling(self, scale: float) -> None:
        """Set the upper bound of the rate, in steps of 0.05 from 0.05 to 1; independent of the client's override."""
        self.ceiling = max(int(scale * _CEILING_STEPS), 1) / _CEILING_STEPS

    def set_scaling(self, scale: float) -> None:
        """Set the share of the wanted speed with which the robot follows, 0 to 1; small changes are none."""
        if scale in (0.0, 1.0) or abs(scale - self.scaling) > _SCALING_STEP:
            self.scaling = scale

    def inherit(self, former: Sequence["Rates"]) -> None:
        """Take over a pause and the smallest speed of the groups before."""
        self.override = min(rates.override for rates in former)
        self.paused = any(rates.paused for rates in former)

    def forget_goals(self) -> None:
        """Keep causes without goals alone: the client's speed, the robot's, a latched stop."""
        self.ceiling, self.paused, self.protective = 1.0, False, None
