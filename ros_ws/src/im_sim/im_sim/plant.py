"""The simulated hardware of one tick: motors, pybullet, grippers, encoders."""

import numpy as np
from numpy.typing import NDArray

from im_core.robot import Cell
from im_core.testbed_link import Command
from im_sim.actuators import Actuators
from im_sim.encoders import Encoders
from im_sim.grippers import Grippers
from im_sim.world import World

_AT_REST = 1e-12


class Plant:
    """Arms, carts and grippers; the same seed and commands give the same bits.

    Args:
        cell: Parameters.
        seed: Of the encoder noise.

    Attributes:
        q: True positions, shape (n,) [rad or m].
        v: True velocities, shape (n,) [rad/s or m/s].
        power: Whether the motors have power.
    """

    def __init__(self, cell: Cell, seed: int) -> None:
        self._dt = cell.period / cell.substeps
        self._substeps = cell.substeps
        self._world = World(cell, self._dt)
        self._actuators = Actuators(cell, self._dt)
        self._grippers = Grippers(cell.gripper)
        self._encoders = Encoders(cell, seed)
        self._n = len(cell.joints)
        self.power = False
        self.q, self.v = self._world.state()

    @property
    def brakes(self) -> NDArray[np.bool_]:
        """Which brakes are engaged, shape (n,)."""
        return self._actuators.brakes

    @property
    def gripper(self) -> NDArray[np.float64]:
        """Openings of the jaws, shape (2,) [m]."""
        return self._grippers.opening

    def encoders(self, tick: int) -> NDArray[np.float64]:
        """What the encoders say at a tick, shape (n,) [rad or m]."""
        return self._encoders.read(tick, self.q)

    def run_tick(self, command: Command | None) -> None:
        """One tick under a command; without one, power is off and every brake engaged.

        What stands still after a step, with every joint stuck, is not stepped again before the next tick.
        """
        if command is None:
            self._actuators.command(np.zeros(self._n), False, np.ones(self._n, dtype=np.bool_))
        else:
            self._actuators.command(command.tau, command.power, command.brakes)
            self._grippers.command(command.gripper)
        self.power = command is not None and command.power
        for _ in range(self._substeps):
            self._world.step(self._actuators.applied(self.q, self.v))
            self.q, self.v = self._world.state()
            if self._actuators.stuck and np.abs(self.v).max() < _AT_REST:
                break
        self._grippers.step(self._dt * self._substeps)

    def close(self) -> None:
        """End the simulation."""
        self._world.close()
