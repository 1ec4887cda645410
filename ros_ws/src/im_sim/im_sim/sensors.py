"""What the testbed's sensors say of what is really so: encoders, force sensors, wrist force-torque sensors.

Their noise depends on seed and tick alone, whatever was read before.
"""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.link import Faults
from im_cell.robot import Cell, SensorSpec
from im_sim.dynamics import Dynamics
from im_sim.world import Contact

_TICKS_PER_BLOCK = 256
_STREAM_SHIFT = 48
_WRIST_STREAM = 1


class TickNoise:
    """Normal noise of several signals.

    Args:
        seed: Key of the noise.
        stream: Which sensor; streams of one seed are independent, 0 to 65535.
        deviation: Standard deviation of each signal, shape (n,).
        mean: Of each signal, shape (n,); zero if not given.
    """

    def __init__(
        self, seed: int, stream: int, deviation: NDArray[np.float64], mean: NDArray[np.float64] | float = 0.0
    ) -> None:
        self._seed = seed & 0xFFFFFFFFFFFFFFFF
        self._stream = stream << _STREAM_SHIFT
        self._deviation, self._mean = deviation, mean
        self._block = -1
        self._draws: NDArray[np.float64] = np.empty((0, 0))

    def at(self, tick: int) -> NDArray[np.float64]:
        """Noise at a tick, shape (n,)."""
        block, row = divmod(tick, _TICKS_PER_BLOCK)
        if block != self._block:
            key = np.array([self._seed, self._stream | block], dtype=np.uint64)
            generator = np.random.Generator(np.random.Philox(key=key))
            draws = generator.standard_normal((_TICKS_PER_BLOCK, len(self._deviation)))
            self._draws = draws * self._deviation + self._mean
            self._block = block
        draw: NDArray[np.float64] = self._draws[row]
        return draw


class Encoders:
    """Reads joint positions as the machine sees them: noise, then quantisation.

    Args:
        cell: Resolution and noise of each joint.
        seed: Key of the noise: the same seed and tick give the same noise, whatever was read before.
    """

    def __init__(self, cell: Cell, seed: int) -> None:
        self._resolution = cell.per_joint("resolution")
        self._noise = TickNoise(seed, 0, cell.per_joint("noise"))
        n = len(self._resolution)
        self._fresh = np.zeros(n)
        self._frozen = np.zeros(n, dtype=np.bool_)
        self._frozen_since = np.zeros(n, dtype=np.int64)
        self._frozen_reading = np.zeros(n)
        self._blind = np.zeros(n, dtype=np.bool_)
        self._sound = True
        self._period_s = cell.period

    def break_(self, faults: Faults, tick: int, q: NDArray[np.float64]) -> None:
        """Put faults in force at a tick, at true positions ``q``, shape (n,): a frozen reading is the one of then."""
        newly = faults.encoder_frozen & ~self._frozen
        self._frozen_since[newly] = tick
        self._frozen_reading[newly] = self._reading(tick, q)[newly]
        self._frozen, self._blind = faults.encoder_frozen, faults.encoder_nan
        self._sound = not (self._frozen.any() or self._blind.any())

    def read(self, tick: int, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Readings of the true positions ``q`` at a tick, shape (n,) [rad or m], and their ages, shape (n,) [s]."""
        reading = self._reading(tick, q)
        if self._sound:
            return reading, self._fresh
        reading = np.where(self._frozen, self._frozen_reading, reading)
        reading[self._blind] = np.nan
        return reading, np.where(self._frozen, (tick - self._frozen_since) * self._period_s, 0.0)

    def _reading(self, tick: int, q: NDArray[np.float64]) -> NDArray[np.float64]:
        reading: NDArray[np.float64] = np.rint((q + self._noise.at(tick)) / self._resolution) * self._resolution
        return reading


class ForceSensors:
    """Sensors of forces or torques: a fixed bias, noise, quantisation, and the end of their range.

    Args:
        specs: Of each signal.
        seed: Of bias and noise.
        stream: As of :class:`TickNoise`; the one after is used for the bias.
    """

    def __init__(self, specs: list[SensorSpec], seed: int, stream: int) -> None:
        bias = TickNoise(seed, stream + 1, np.array([spec.bias for spec in specs])).at(0)
        self._noise = TickNoise(seed, stream, np.array([spec.noise for spec in specs]), bias)
        self._resolution = np.array([spec.resolution for spec in specs])
        self._most = np.array([spec.range for spec in specs])
        self._least = -self._most

    def read(self, tick: int, true: NDArray[np.float64]) -> NDArray[np.float64]:
        """Readings of ``true``, shape (n,), at a tick [N or Nm]."""
        steps = np.rint((true + self._noise.at(tick)) / self._resolution) * self._resolution
        reading: NDArray[np.float64] = np.minimum(np.maximum(steps, self._least), self._most)
        return reading


class WristSensors:
    """Wrist force-torque sensors: what each arm exerts on its link 6 and on all that hangs on it.

    Force and torque are in the axes and about the origin of each wrist frame. With the spatial inertia I of link 6
    and its load, its spatial velocity v and acceleration a, and the wrench w of what it touches, the arm exerts ``I
    (a - g) + v x* I v - w``: the recursive Newton-Euler algorithm gives the first two terms from the motion that
    physics has found, contacts included.

    Args:
        cell: Noise, bias, resolution, range.
        dynamics: Of the arms with their loads.
        seed: Of noise and bias.
    """

    def __init__(self, cell: Cell, dynamics: Dynamics, seed: int) -> None:
        self._dynamics = dynamics
        sensor = cell.wrist_sensor
        self._sensors = ForceSensors(([sensor.force] * 3 + [sensor.torque] * 3) * len(cell.sides), seed, _WRIST_STREAM)
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
