"""Wrist force-torque sensors: what each arm exerts on its link 6 and on all that hangs on it."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.robot import Cell
from im_sim.dynamics import Dynamics
from im_sim.noise import ForceSensors
from im_sim.world import Contact

_STREAM = 1


class WristSensors:
    """Force and torque in the axes and about the origin of each wrist frame.

    With the spatial inertia I of link 6 and its load, its spatial velocity v and acceleration a, and the wrench w of
    what it touches, the arm exerts ``I (a - g) + v x* I v - w``: the recursive Newton-Euler algorithm gives the first
    two terms from the motion that physics has found, contacts included.

    Args:
        cell: Noise, bias, resolution, range.
        dynamics: Of the arms with their loads.
        seed: Of noise and bias.
    """

    def __init__(self, cell: Cell, dynamics: Dynamics, seed: int) -> None:
        self._dynamics = dynamics
        sensor = cell.wrist_sensor
        self._sensors = ForceSensors(([sensor.force] * 3 + [sensor.torque] * 3) * len(cell.sides), seed, _STREAM)
        self._true = np.zeros((len(cell.sides), 6))
        self._signals = self._true.ravel()  # the same memory

    def read(self, tick: int) -> NDArray[np.float64]:
        """Readings at a tick, force then torque of each side, shape (2, 6) [N, Nm]."""
        return self._sensors.read(tick, self._signals).reshape(-1, 6)

    @property
    def true(self) -> NDArray[np.float64]:
        """What really acts, shape (2, 6) [N, Nm]."""
        return self._true

    def update(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        a: NDArray[np.float64],
        contacts: list[list[Contact]],
    ) -> None:
        """Find the wrenches of a step.

        Args:
            q: Positions at its start, shape (n,) [rad or m].
            v: Velocities at its start, shape (n,).
            a: Accelerations during it, shape (n,).
            contacts: What touched link 6 of each side.
        """
        dynamics = self._dynamics
        pin.rnea(dynamics.model, dynamics.data, q, v, a)
        if any(contacts):
            pin.forwardKinematics(dynamics.model, dynamics.data, q)  # contacts are told in the world
        for side, ((joint, wrist), wrench) in enumerate(zip(dynamics.wrists, dynamics.wrist_forces, strict=True)):
            if contacts[side]:
                wrench = wrench - _contact_wrench(dynamics.data.oMi[joint], contacts[side])
            self._true[side] = wrist.actInv(wrench).vector


def _contact_wrench(pose: pin.SE3, contacts: list[Contact]) -> pin.Force:
    """What contacts exert on a link at ``pose``, in its frame."""
    force = sum((contact.force for contact in contacts), np.zeros(3))
    torque = sum((np.cross(contact.position, contact.force) for contact in contacts), np.zeros(3))
    return pose.actInv(pin.Force(force, torque))
