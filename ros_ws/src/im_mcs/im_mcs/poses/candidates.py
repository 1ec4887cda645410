"""Candidate poses: the light anywhere in the common view, turned to all cameras, or as the arm holds it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.stats import qmc

from im_cell.robot import Cell
from im_mcs.poses.common import CommonView
from im_mcs.poses.view import View, facing

_BLOCK = 512
# Nominal cameras and mounts may be off by this: the light faces them with this margin [rad].
_FACING_MARGIN = 0.09


@dataclass(frozen=True, eq=False)
class Candidate:
    """Pose of the wrist with the place of the light.

    Attributes:
        light: Position of the light in ``world``, shape (3,) [m].
        wrist: Pose of the wrist in ``world``.
    """

    light: NDArray[np.float64]
    wrist: pin.SE3


def candidates(
    cell: Cell, common: CommonView, views: Sequence[View], max_tilt_rad: float, seed: int, draws: int
) -> Iterator[Candidate]:
    """Candidates, space-filling in light position and orientation together.

    The light's outward axis points where the largest angle to a camera is least, tilted by up to ``max_tilt_rad`` to
    any side as long as it shines at all cameras, and the wrist is turned about that axis by any angle. Positions out
    of reach or out of an image are left out.

    Args:
        cell: Light.
        common: Where it can be seen, and shall be.
        views: Cameras that shall see it.
        max_tilt_rad: Largest tilt [rad].
        seed: Of the scrambled Halton sequence.
        draws: Length of the sequence.
    """
    offset, axis, least_cosine = _light(cell)
    sequence = qmc.Halton(6, seed=seed)
    for _ in range(0, draws, _BLOCK):
        drawn = sequence.random(_BLOCK)
        lights = common.lower + drawn[:, :3] * (common.upper - common.lower)
        for k in np.flatnonzero(common.holds(lights)):
            light, s = lights[k], drawn[k]
            towards, best = facing(light, views)
            outward = _tilted(best, np.sqrt(s[3]) * max_tilt_rad, s[4])
            if (towards @ outward).min() < least_cosine:
                continue
            aim = pin.Quaternion.FromTwoVectors(axis, outward).matrix()
            rotation = aim @ pin.exp3(axis * (2.0 * np.pi * s[5]))
            yield Candidate(light, pin.SE3(rotation, light - rotation @ offset))


def held(cell: Cell, wrists: Iterable[pin.SE3], views: Sequence[View], max_tilt_rad: float) -> Iterator[Candidate]:
    """Candidates of an arm that cannot turn its wrist freely: as it holds the light, if that faces all cameras.

    Args:
        cell: Light.
        wrists: Poses of the wrist in ``world`` with the light in view.
        views: Cameras that shall see it.
        max_tilt_rad: Largest tilt away from where it faces all cameras best [rad].
    """
    offset, axis, least_cosine = _light(cell)
    for wrist in wrists:
        light, outward = wrist.act(offset), wrist.rotation @ axis
        towards, best = facing(light, views)
        if (towards @ outward).min() >= least_cosine and best @ outward >= np.cos(max_tilt_rad):
            yield Candidate(light, wrist)


def _light(cell: Cell) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return place and axis of the light in the wrist's frame, and the least cosine of its angle to a camera."""
    axis = np.array(cell.led.axis) / np.linalg.norm(cell.led.axis)
    return np.array(cell.led.offset), axis, float(np.cos(min(cell.led.half_angle - _FACING_MARGIN, np.pi)))


def _tilted(direction: NDArray[np.float64], angle: float, turn: float) -> NDArray[np.float64]:
    """Return a direction ``angle`` away from another, to the side given by ``turn`` in 0..1."""
    basis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).matrix()
    phi = 2.0 * np.pi * turn
    local = np.array([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)])
    return np.asarray(basis @ local)
