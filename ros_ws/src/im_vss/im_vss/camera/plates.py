"""Printed plates as obstacles: they stop the laser, and hide lights."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.robot.scenery import Target
from im_vss.camera.targets import BLACK, WHITE, ink

Array = NDArray[np.float64]

_MISSED = 2.0


@dataclass(frozen=True)
class _Plate:
    """A plate and its pose: rotation to the world, shape (3, 3), and its middle there [m]."""

    target: Target
    rotation: Array
    position: Array


class Plates:
    """All plates of a cell, infinitely thin, opaque from both sides; their backs are white."""

    def __init__(self, targets: Sequence[Target]) -> None:
        """Place the plates."""
        self._plates = [_Plate(target, *target.pose()) for target in targets]

    def first(self, starts: Array, ends: Array) -> tuple[Array, Array, Array]:
        """Where rays first meet a plate.

        Args:
            starts: Shape (n, 3) [m].
            ends: Shape (n, 3) [m].

        Returns:
            Share of each way up to there, shape (n,), 2 where none is met; normals towards the start, shape (n, 3); and
            albedo, shape (n,).
        """
        share, normals = np.full(len(starts), _MISSED), np.zeros((len(starts), 3))
        albedo = np.zeros(len(starts))
        for plate in self._plates:
            pierced, x, y, side = _pierce(plate, starts, ends)
            nearer = pierced < share
            share[nearer], normals[nearer] = pierced[nearer], side[nearer, None] * plate.rotation[:, 2]
            printed = ink(plate.target, x[nearer], y[nearer]) & (side[nearer] > 0.0)
            albedo[nearer] = np.where(printed, BLACK, WHITE)
        return share, normals, albedo

    def clear(self, start: Array, end: Array) -> bool:
        """Whether no plate stands between two points of the world, shape (3,) [m]."""
        return bool(self.first(start[None], end[None])[0][0] > 1.0)


def _pierce(plate: _Plate, starts: Array, ends: Array) -> tuple[Array, Array, Array, Array]:
    """Share of each way, shape (n, 3) each end, up to a plate, 2 where it is missed; where on it [m]; whence."""
    start, end = (starts - plate.position) @ plate.rotation, (ends - plate.position) @ plate.rotation
    half = 0.5 * plate.target.plate
    with np.errstate(divide="ignore", invalid="ignore"):
        share = start[:, 2] / (start[:, 2] - end[:, 2])
        x, y, _ = (start + share[:, None] * (end - start)).T
        met = (share >= 0.0) & (share <= 1.0) & (np.abs(x) <= half) & (np.abs(y) <= half)
    return np.where(met, share, _MISSED), x, y, np.sign(start[:, 2])
