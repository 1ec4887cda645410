"""Channel driver without hardware: every joint a separate mass. For tests and for trying a controller."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_mcs.limits.slots import Interface
from im_mcs.testbed.driver import Drive, Measured

_LAG_S = 0.02


class LoopbackDriver:
    """Joints ``inertia * qdd = tau - bias(q)``, integrated semi-implicitly; a braked joint stands still.

    A joint that takes velocities has its velocity at once; one that takes positions goes there as a first-order lag.

    Jaws are at once where they are told to be; nothing presses on them or on the wrists.

    Args:
        inertia: Inertia of each joint, shape (n,) [kg m2 or kg].
        q: Where the joints are at first, shape (n,) [rad or m].
        period_s: Servo period [s].
        bias: Torques that positions cause, such as gravity; none if not given.
        grippers, wrenches: Numbers of grippers and wrist sensors.
        interfaces: Kinds of commands by channel; torques where none is given.
    """

    wall_period_s = 0.0
    interfaces_taken = ("effort", "velocity", "position")

    def __init__(
        self,
        inertia: ArrayLike,
        q: ArrayLike,
        period_s: float = 0.0045,
        bias: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
        grippers: int = 2,
        wrenches: int = 2,
        interfaces: Mapping[int, Interface] | None = None,
    ) -> None:
        self._interfaces = dict(interfaces or {})
        self._inertia = np.asarray(inertia, dtype=np.float64)
        self.n_joints, self.n_grippers, self.n_wrenches = len(self._inertia), grippers, wrenches
        self.period_s = period_s
        self.q = np.array(q, dtype=np.float64)
        self.v = np.zeros(self.n_joints)
        self.drive = Drive(
            np.zeros(self.n_joints), False, np.ones(self.n_joints, dtype=np.bool_), np.zeros(grippers), False,
            np.zeros(grippers),
        )  # fmt: skip
        self._bias = bias
        self._tick = 0

    def connect(self) -> None:
        """Nothing to reach."""

    def wait(self, timeout_s: float) -> bool:
        """The next tick is always there."""
        return True

    def read(self) -> Measured:
        """Exact positions; power and brakes as commanded."""
        return Measured(
            self._tick,
            round(self._tick * self.period_s * 1e9),
            self.q.copy(),
            self.drive.power,
            self.drive.brakes | (not self.drive.power),
            self.drive.gripper,
            np.zeros(self.n_joints),
            np.zeros((self.n_wrenches, 6)),
            np.zeros(self.n_grippers),
        )

    def write(self, drive: Drive) -> None:
        """Let one period pass."""
        self.drive = drive
        braked = drive.brakes | (not drive.power)
        bias = self._bias(self.q) if self._bias is not None else 0.0
        v = self.v + (drive.command - bias) / self._inertia * self.period_s
        for joint, kind in self._interfaces.items():
            if kind == "velocity":
                v[joint] = drive.command[joint]
            elif kind == "position":
                v[joint] = (drive.command[joint] - self.q[joint]) / _LAG_S
        self.v = np.where(braked, 0.0, v)
        self.q = self.q + self.v * self.period_s
        self._tick += 1

    def after_tick(self, tick: int) -> None:
        """Nothing to wait for."""

    def close(self) -> None:
        """Power off, brakes on."""
        self.v = np.zeros(self.n_joints)
