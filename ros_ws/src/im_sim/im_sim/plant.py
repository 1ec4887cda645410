"""The simulated hardware of one tick: motors, pybullet, grippers, sensors."""

import numpy as np
from numpy.typing import NDArray

from im_cell.link import Drive, Faults, JawObject, Sensors
from im_cell.robot import Cell
from im_sim.actuators import Actuators
from im_sim.brakes import HoldingBrakes
from im_sim.dynamics import Dynamics
from im_sim.fingers import FingerJaws
from im_sim.grippers import GripperJaws
from im_sim.sensors import Encoders, Signals, WristWrenches
from im_sim.world import World

_AT_REST = 1e-12
#: For how long arms that have lost their power want time to come to rest, at most [s].
_SETTLE_S = 2.0


class Plant:
    """Arms, carts and grippers; the same seed and commands give the same bits.

    Attributes:
        q: True positions, shape (n,) [rad or m].
        v: True velocities, shape (n,) [rad/s or m/s].
        power: Whether the motors have power.
        settling: Whether the arms have lost their power and have not come to rest: time goes on for them.
    """

    def __init__(self, cell: Cell, seed: int) -> None:
        self._dt = cell.period / cell.substeps
        self._period = cell.period
        self._substeps = cell.substeps
        self._world = World(cell, self._dt)
        self._dynamics = Dynamics(cell)
        self._actuators = Actuators(cell, self._dynamics, self._dt)
        self._bodies = self._world.bodies
        count = len(cell.devices("gripper"))
        self._grippers = (
            FingerJaws(cell.gripper, count, self._world) if self._bodies else GripperJaws(cell.gripper, count)
        )
        self._wrists = WristWrenches(self._dynamics)
        self._signals = Signals(cell, seed)
        self._encoders = Encoders(cell)
        self._last_joints = [joint - 1 for joint, _ in self._dynamics.wrists]
        self._gripper_joints = [joint - 1 for joint in self._dynamics.gripper_joints]
        self._n = len(cell.joints)
        self._dt_each = np.full(self._n, self._dt)
        self._held_brakes = np.ones(self._n, dtype=np.bool_)
        self._brakes = HoldingBrakes(self._n, round(cell.brakes.delay / cell.period))
        self._settle_ticks = round(_SETTLE_S / cell.period)
        self._faults, self._may_hold = Faults.none(self._n), self._held_brakes
        self._tick = self._settled_at = 0
        self._stands = False
        self.power = self.settling = False
        self.q, self.v = self._world.state()
        self._feel(self.q, self.v)

    @property
    def brakes(self) -> NDArray[np.bool_]:
        """Which brakes are engaged, shape (n,)."""
        return self._actuators.brakes

    @property
    def gripper(self) -> NDArray[np.float64]:
        """Openings of the jaws, shape (grippers,) [m]."""
        return self._grippers.opening

    @property
    def wrench(self) -> NDArray[np.float64]:
        """True wrenches of the arms on the links of the wrists with all the loads, shape (wrists, 6) [N, Nm]."""
        return self._wrists.true

    def sensors(self, tick: int) -> Sensors:
        """Return the readings of the sensors at a tick."""
        self._tick = tick
        q, wrench, gripper_force = self._signals.read(tick, self.q, self._wrists.true, self._grippers.force)
        q, age_s = self._encoders.tell(tick, q)
        return Sensors(
            q=q,
            power=self.power,
            brakes=self._actuators.brakes,
            gripper=self._grippers.opening,
            age_s=age_s,
            wrench=wrench,
            gripper_force=gripper_force,
        )

    def break_(self, faults: Faults) -> None:
        """Replace the faults in force."""
        self._faults, self._may_hold = faults, ~faults.brake_open
        q, _, _ = self._signals.read(self._tick, self.q, self._wrists.true, self._grippers.force)
        self._encoders.break_(faults, self._tick, q)

    def put(self, objects: tuple[JawObject | None, ...]) -> None:
        """Set the object between the jaws of each gripper."""
        self._grippers.put(objects)
        self._dynamics.carry(self._grippers.held())
        self._stands = False

    def place(self, body: int, pose: NDArray[np.float64]) -> None:
        """Put a free body somewhere, at rest: rank in the cell, position [m] and quaternion x, y, z, w, shape (7,)."""
        self._bodies.place(body, pose)

    def bodies(self) -> NDArray[np.float64]:
        """Return the poses of the free bodies, shape (m, 7) [m, -]."""
        return self._bodies.poses()

    def prepare(self) -> None:
        """Compute ahead of the command the part of the next tick depending on the present state only."""
        if not self._stands:
            self._actuators.prepare(self.q, self.v)

    def run_tick(self, command: Drive | None) -> None:
        """One tick under a command; without one, power is off. Without power every brake is told to hold.

        What stands still after a step, with every joint stuck, is not stepped again before the next tick, nor, without
        power, before anything else is commanded.
        """
        held_before, powered_before = self._actuators.brakes, self.power
        self.power = command is not None and command.power and not self._faults.power_loss
        self._brakes.tick(command.brakes if command is not None and self.power else self._held_brakes)
        held = self._brakes.engaged | self._faults.brake_stuck
        tau = np.zeros(self._n) if command is None else command.command
        self._actuators.command(tau, self.power, held & self._may_hold)
        if command is not None:
            self._grippers.command(command.gripper, command.gripper_force)
        self._tick += 1
        if powered_before and not self.power:
            self._settled_at = self._tick + self._settle_ticks
        if not self._stands or self.power or held_before.tobytes() != self._actuators.brakes.tobytes():
            self._move()
        unpowered = not self.power and self._tick < self._settled_at
        self.settling = unpowered and not (self._stands and self._brakes.obey)
        if self._grippers.step(self._period):
            self._dynamics.carry(self._grippers.held())
            self._stands = False

    def close(self) -> None:
        """End the simulation."""
        self._world.close()

    def _move(self) -> None:
        """Do the steps of a tick, until nothing moves; without power the plant then stands."""
        self._stands, actuators, bodies = False, self._actuators, len(self._bodies)
        for _ in range(self._substeps):
            q, v = self.q, self.v
            self.q, self.v = self._world.step(actuators.applied(q, v))
            if bodies:
                touched = self._world.contact_wrenches(self._gripper_joints)
                actuators.touch(self._dynamics.contact_torques(self.q, touched))
            elif actuators.stuck and max(map(abs, self.v.tolist())) < _AT_REST:
                self._stands = not self.power
                break
        self._feel(q, v)

    def _feel(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Give the wrist sensors the step from ``q`` with ``v``, shape (n,) each."""
        self._wrists.update(q, v, (self.v - v) / self._dt_each, self._world.contact_wrenches(self._last_joints))
