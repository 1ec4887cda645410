"""The laser scanner's mirrors, moving at a finite rate and never coming to rest at quite the same angle."""

import numpy as np

from im_cell.link import LaserBeam
from im_cell.robot import LaserScanner

_STREAM = 5


class Laser:
    """Moves the mirrors of one tick.

    Args:
        scanner: Ranges and rate; None: there is none, and the beam stays dark.
        period_s: Length of a tick [s].
        seed: Of the mirrors' errors.

    Attributes:
        beam: What the scanner's own sensors say.
    """

    def __init__(self, scanner: LaserScanner | None, period_s: float, seed: int) -> None:
        self._scanner = scanner
        self._step = 0.0 if scanner is None else scanner.rate * period_s
        self._seed = seed
        self._command = self.beam = LaserBeam()
        self._commands = 0
        self._error = (0.0, 0.0)
        self._resting = False

    @property
    def true(self) -> LaserBeam:
        """Where the mirrors really are."""
        beam, (first, second) = self.beam, self._error
        return LaserBeam(beam.mirror1 + first, beam.mirror2 + second, beam.half_sweep, beam.power)

    def run_tick(self, command: LaserBeam) -> None:
        """Move towards a command, as far as the mirrors go in a tick and in all; a sweep stays inside the range too."""
        if self._scanner is None or (self._resting and command is self._command):
            return
        if command != self._command:
            self._commands += 1
            seed = np.random.SeedSequence([self._seed & 0xFFFFFFFFFFFFFFFF, _STREAM, self._commands])
            first, second = np.random.Generator(np.random.Philox(seed)).normal(0.0, self._scanner.repeatability, 2)
            self._error = float(first), float(second)
        self._command = command
        beam, limit = self.beam, self._scanner.range
        mirror1 = self._towards(beam.mirror1, command.mirror1, limit)
        mirror2 = self._towards(beam.mirror2, command.mirror2, limit)
        half_sweep = min(max(command.half_sweep, 0.0), limit - abs(mirror1))
        self.beam = LaserBeam(mirror1, mirror2, half_sweep, min(max(command.power, 0.0), 1.0))
        self._resting = self.beam == beam

    def _towards(self, angle: float, wanted: float, limit: float) -> float:
        wanted = min(max(wanted, -limit), limit)
        return angle + min(max(wanted - angle, -self._step), self._step)
