"""Readings of the testbed's sensors for a true state: encoders, force sensors, wrist force-torque sensors.

Their noise depends on seed and tick alone, whatever was read before.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.link import Faults
from im_cell.robot import Cell, SensorSpec
from im_sim.dynamics import Dynamics
from im_sim.readings import Readings

_TICKS_PER_BLOCK = 256
_STREAM_SHIFT = 48
_ENCODERS, _WRISTS, _WRISTS_BIAS, _JAWS, _JAWS_BIAS = range(5)  # streams of one seed, independent of each other


class TickNoise:
    """Normal noise of the signals of several sensors.

    Args:
        seed: Key of the noise.
        deviations: Standard deviation of each signal of a sensor, by the sensor's stream, 0 to 65535.
        mean: Of each signal, of one sensor after the other, shape (n,); zero if not given.
    """

    def __init__(
        self,
        seed: int,
        deviations: Mapping[int, NDArray[np.float64]],
        mean: NDArray[np.float64] | float = 0.0,
    ) -> None:
        self._seed = seed & 0xFFFFFFFFFFFFFFFF
        self._deviations, self._mean = deviations, mean
        self._block = -1
        self._noise: NDArray[np.float64] = np.empty((0, 0))

    def at(self, tick: int) -> NDArray[np.float64]:
        """Noise at a tick, of one sensor after the other, shape (n,)."""
        block, row = divmod(tick, _TICKS_PER_BLOCK)
        if block != self._block:
            sensors = [self._draw(block, stream, deviation) for stream, deviation in self._deviations.items()]
            self._noise = np.hstack(sensors) + self._mean
            self._block = block
        noise: NDArray[np.float64] = self._noise[row]
        return noise

    def _draw(self, block: int, stream: int, deviation: NDArray[np.float64]) -> NDArray[np.float64]:
        key = np.array([self._seed, stream << _STREAM_SHIFT | block], dtype=np.uint64)
        generator = np.random.Generator(np.random.Philox(key=key))
        return generator.standard_normal((_TICKS_PER_BLOCK, len(deviation))) * deviation


class Signals:
    """Every signal of the cell's sensors in one row: a fixed bias, noise, quantisation, and the end of the range.

    Encoders have neither bias nor end; a joint is off its encoder by the error of its gear.

    Args:
        cell: Noise, bias, resolution, range.
        seed: Of noise and bias: the same seed and tick give the same, whatever was read before.
    """

    def __init__(self, cell: Cell, seed: int) -> None:
        sensors, grippers = len(cell.devices("force")), len(cell.devices("gripper"))
        wrist = cell.wrist_sensor
        wrists, jaws = ([wrist.force] * 3 + [wrist.torque] * 3) * sensors, [cell.gripper.force_sensor] * grippers
        bias = TickNoise(seed, {_WRISTS_BIAS: _each("bias", wrists), _JAWS_BIAS: _each("bias", jaws)}).at(0)
        self._noise = TickNoise(
            seed,
            {_ENCODERS: cell.per_joint("noise"), _WRISTS: _each("noise", wrists), _JAWS: _each("noise", jaws)},
            np.append(np.zeros(len(cell.joints)), bias),
        )
        resolution = np.append(cell.per_joint("resolution"), _each("resolution", wrists + jaws))
        most = np.append(np.full(len(cell.joints), np.inf), _each("range", wrists + jaws))
        self._readings = Readings(cell.per_joint("gear"), resolution, most, sensors)

    def read(
        self, tick: int, q: NDArray[np.float64], wrench: NDArray[np.float64], force: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the readings at a tick.

        Args:
            tick: Number of the tick.
            q: True positions, shape (n,) [rad or m].
            wrench: What really acts at the wrists, shape (wrists, 6) [N, Nm].
            force: What really acts between the jaws, shape (grippers,) [N].

        Returns:
            What encoders, wrist sensors and jaws say, shapes as those given.
        """
        return self._readings.told(q, wrench, force, self._noise.at(tick))


class Encoders:
    """Faults of encoder readings on the way to the servo: some are stuck, some are lost."""

    def __init__(self, cell: Cell) -> None:
        n = len(cell.joints)
        self._fresh = np.zeros(n)
        self._frozen = np.zeros(n, dtype=np.bool_)
        self._frozen_since = np.zeros(n, dtype=np.int64)
        self._frozen_reading = np.zeros(n)
        self._blind = np.zeros(n, dtype=np.bool_)
        self._sound = True
        self._period_s = cell.period

    def break_(self, faults: Faults, tick: int, reading: NDArray[np.float64]) -> None:
        """Put faults in force at a tick with the given reading, shape (n,): a frozen one stays unchanged."""
        newly = faults.encoder_frozen & ~self._frozen
        self._frozen_since[newly] = tick
        self._frozen_reading[newly] = reading[newly]
        self._frozen, self._blind = faults.encoder_frozen, faults.encoder_nan
        self._sound = not (self._frozen.any() or self._blind.any())

    def tell(self, tick: int, reading: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the delivered reading of a tick, shape (n,) [rad or m], and the age, shape (n,) [s]."""
        if self._sound:
            return reading, self._fresh
        told = np.where(self._frozen, self._frozen_reading, reading)
        told[self._blind] = np.nan
        return told, np.where(self._frozen, (tick - self._frozen_since) * self._period_s, 0.0)


class WristWrenches:
    """Inputs of the wrist force-torque sensors: the wrench of each arm on its last link with all loads.

    Force and torque are in the axes and about the origin of each wrist frame. With the spatial inertia I of that link
    and its load, its spatial velocity v and acceleration a, and the wrench w of what it touches, the arm exerts ``I
    (a - g) + v x* I v - w``: the recursive Newton-Euler algorithm gives the first two terms from the motion that
    physics has found, contacts included.

    Attributes:
        true: What really acts, force then torque of each side, shape (wrists, 6) [N, Nm].
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self.true = np.zeros((len(dynamics.wrists), 6))

    def update(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        a: NDArray[np.float64],
        contacts: Sequence[Sequence[float]],
    ) -> None:
        """Find the wrenches of a step.

        Args:
            q: Positions at its start, shape (n,) [rad or m].
            v: Velocities at its start, shape (n,).
            a: Accelerations during it, shape (n,).
            contacts: What touched the last link of each arm.
        """
        dynamics = self._dynamics
        pin.rnea(dynamics.model, dynamics.data, q, v, a)
        if any(contacts):
            pin.forwardKinematics(dynamics.model, dynamics.data, q)  # contacts are told in the world
        for side, ((joint, wrist), wrench) in enumerate(zip(dynamics.wrists, dynamics.wrist_forces, strict=True)):
            if contacts[side]:
                wrench = wrench - dynamics.data.oMi[joint].actInv(pin.Force(np.array(contacts[side])))
            self.true[side] = wrist.actInv(wrench).vector


def _each(value: str, specs: Sequence[SensorSpec]) -> NDArray[np.float64]:
    """One value of each signal's sensor."""
    return np.array([getattr(spec, value) for spec in specs])
