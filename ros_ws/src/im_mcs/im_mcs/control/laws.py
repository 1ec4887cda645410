"""The control laws of one group, of which one is in force; changed at run time without a bump."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ConfigError, NotFoundError
from im_mcs.control.controller import ControlInput
from im_mcs.control.guard import GuardedLaw
from im_mcs.control.law_process import RemoteLaw
from im_mcs.model import ControlledModel

_SHADOW_S = 0.036
_CONFIGURED: Mapping[str, Any] = MappingProxyType({})


@dataclass
class _Share:
    """Working law, and the remaining share of the previous law.

    Attributes:
        law: The law.
        error: Position error that it found, shape (n,) [rad or m].
        torque: What the torque before differed by from its own when it took over, shape (n,) [Nm or N].
        left: Share of both that is left, 1 to 0.
        ticks: How long it has been in the shadow, then in force [ticks].
    """

    law: GuardedLaw | RemoteLaw
    error: NDArray[np.float64] | None = None
    torque: NDArray[np.float64] | None = None
    left: float = 0.0
    ticks: int = 0

    def answer(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques of the law, shape (n,), with the rest of the law before."""
        if self.left > 0.0 and self.error is not None:
            setpoint = given.setpoint._replace(q=given.setpoint.q - self.left * self.error)
            given = given._replace(setpoint=setpoint)
        tau = self.law.command(given)
        return tau if self.torque is None or self.left == 0.0 else tau + self.left * self.torque


class ControlLaws:
    """A controller made of several.

    A law that is asked for first runs for 36 ms in the shadow of the one in force, so that its filters know the past.
    Then it takes over. What its torque differs by from the last one is added, so that the torque goes on where it was;
    and its setpoint begins where the arm is, so that no error makes its integral run. Both fade along half a cosine
    within ``handover_s``, while integral and arm adapt: the handover changes the torque by at most
    ``pi / 2 * difference / handover_s`` in a second.

    Args:
        laws: Every law that may be asked for, by its name ``module:Class``; not empty.
        name: The one in force at first.
        period_s: Servo period [s].
        handover_s: Time in which the difference fades [s].
        model: The laws' model, if what the arms carry may change: while it does, nothing is at rest, and integrals run.
        make: Makes a law with parameters in place of some of the configuration's; None: there is no other.
    """

    def __init__(
        self,
        laws: Mapping[str, GuardedLaw | RemoteLaw],
        name: str,
        period_s: float,
        handover_s: float,
        model: ControlledModel | None = None,
        make: Callable[[str, Mapping[str, Any]], GuardedLaw] | None = None,
    ) -> None:
        self._laws = dict(laws)
        self._make, self._given = make, dict[str, Mapping[str, Any]]()
        self._model = model
        self._shadow_ticks = math.ceil(_SHADOW_S / period_s)
        self._fade_ticks = math.ceil(handover_s / period_s)
        self.name = name
        self._present = _Share(self._laws[name])
        self._next: _Share | None = None
        self._before: NDArray[np.float64] | None = None

    @property
    def switching(self) -> bool:
        """Whether a handover, or a change of payload, is under way: the arm then counts as moving."""
        return self._next is not None or self._present.left > 0.0 or self._model_changes

    @property
    def late(self) -> int:
        """Number of late answers of laws in separate processes; the ticks went on without the answers."""
        return sum(law.late for law in self._laws.values() if isinstance(law, RemoteLaw))

    @property
    def _model_changes(self) -> bool:
        return self._model is not None and self._model.changing

    def switch(self, name: str, parameters: Mapping[str, Any] = _CONFIGURED) -> bool:
        """Let another law take over from the next tick on; return whether it is not in force already.

        Args:
            name: Its name.
            parameters: In place of those of the configuration; what is not named is as configured.

        Raises:
            NotFoundError: The configuration has no such law.
            ConfigError: A parameter is none of the law's, or out of range; or the law has a process of its own.
        """
        if name not in self._laws:
            raise NotFoundError(kind="control law", name=name, known=self._laws)
        known = parameters == self._given.get(name, _CONFIGURED)
        if known and name == self.name:
            return False
        if not known:
            if self._make is None or isinstance(self._laws[name], RemoteLaw):
                raise ConfigError(f"{name} has a process of its own, and takes no other parameters while that runs")
            self._laws[name], self._given[name] = self._make(name, parameters), dict(parameters)
        self.name = name
        law = self._laws[name]
        if law is self._present.law:  # called back while the other was still in the shadow
            self._next = None
            return True
        self._next = _Share(law, left=1.0)
        law.reset()
        return True

    def reset(self, before: NDArray[np.float64] | None = None) -> None:
        """Start anew with the law asked for last, at once; the arm stands still.

        Args:
            before: Commands of other laws from which to go on without a bump, shape (n,); None: there were none.
        """
        self._present, self._next = _Share(self._laws[self.name], left=0.0 if before is None else 1.0), None
        self._before = before
        self._present.law.reset()

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free accumulated terms."""
        self._present.law.hold_integral(hold)

    def command(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques, velocities or positions for the current tick, shape (n,).

        Raises:
            ControlLawError: A law failed, be it the one in the shadow.
        """
        present, coming = self._present, self._next
        if self._model_changes:
            present.law.hold_integral(False)
        if (before := self._before) is not None:
            present.error, self._before = given.setpoint.q - given.q, None
            present.torque = before - present.answer(given)
            return before
        if coming is None and present.left > 0.0:
            present.ticks += 1
            past = present.ticks / self._fade_ticks
            present.left = 0.5 * (1.0 + math.cos(math.pi * past)) if past < 1.0 else 0.0
        tau = present.answer(given)
        if coming is not None:
            coming.ticks += 1
            if coming.error is None:
                coming.error = given.setpoint.q - given.q
            own = coming.answer(given)
            if coming.ticks >= self._shadow_ticks:
                coming.torque, coming.ticks = tau - own, 0
                self._present, self._next = coming, None
        return tau
