"""Functions of the user's at servo rate: named in ``mcs.yaml``, called after the slots are written."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_core.errors import FOREIGN
from im_core.rate_groups import RateGroups
from im_mcs.limits.configuration import ServoFunction
from im_mcs.servo.core import Mcs


@dataclass(frozen=True)
class FunctionSetup:
    """Setup of a function at servo rate.

    Attributes:
        joints: Names of all joints, in the order of all arrays.
        period_s: Servo period [s].
        parameters: The ``parameters`` of the configuration.
    """

    joints: tuple[str, ...]
    period_s: float
    parameters: dict[str, Any]


@dataclass(frozen=True)
class ServoReading:
    """Result of a tick, for functions at servo rate; arrays of a function's own, n joints.

    Attributes:
        tick: Number of the tick.
        stamp_ns: Time of the testbed at which the slots were read [ns].
        state: State of MCS.
        q: Measured positions, shape (n,) [rad or m].
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        tau: Torques, shape (n,) [Nm or N].
        setpoint: Positions, velocities and accelerations that are followed, shape (3, n).
        gripper: Openings of the grippers, shape (grippers,) [m].
        wrench: Forces and torques of the sensors, shape (sensors, 6) [N, Nm].
    """

    tick: int
    stamp_ns: int
    state: str
    q: NDArray[np.float64]
    v: NDArray[np.float64]
    tau: NDArray[np.float64]
    setpoint: NDArray[np.float64]
    gripper: NDArray[np.float64]
    wrench: NDArray[np.float64]


class ServoFunctions:
    """Functions of a configuration, registered behind the servo's own.

    Raises:
        ConfigError: One cannot be loaded, or refuses its parameters.
        DataError: Phase and rate of one do not go together.
    """

    def __init__(self, configured: Mapping[str, ServoFunction], mcs: Mcs, rates: RateGroups) -> None:
        self._functions: list[object] = []
        for name, each in configured.items():
            setup = FunctionSetup(tuple(mcs.model.names), rates.period_s, each.parameters)
            function: Callable[[ServoReading], object]
            function = plugins.make(each.function, "servo function", setup)  # type: ignore[assignment]
            self._functions.append(function)
            rates.register(
                name,
                partial(_call, function, mcs),
                every=each.every,
                times=each.times,
                phase=each.phase,
                overrun=each.overrun,
                budget_s=each.budget_s,
            )

    def close(self) -> None:
        """Call ``close`` of each function that has one; errors change nothing."""
        for function in self._functions:
            with suppress(*FOREIGN):
                getattr(function, "close", lambda: None)()
        self._functions.clear()


def _call(function: Callable[[ServoReading], object], mcs: Mcs, _: float) -> None:
    m = mcs.measured
    arrays = (m.q, mcs.v, mcs.tau, mcs.setpoint, m.gripper, m.wrench)
    state = mcs.manager.state.value
    function(ServoReading(m.tick, m.stamp_ns, state, *(np.array(array) for array in arrays)))
