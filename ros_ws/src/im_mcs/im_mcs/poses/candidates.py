"""Candidate poses: light or board anywhere in the common view, turned to all cameras, or as the arm holds it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.stats import qmc

from im_cell.robot import Cell, Target
from im_mcs.poses.common import CommonView
from im_mcs.poses.view import View, facing

_BLOCK = 512
# Nominal cameras and mounts may be off by this: the light faces them with this margin [rad].
_FACING_MARGIN = 0.09
# Of a board seen from farther off its axis [rad], or with smaller squares in the image, the corners run together.
_BOARD_HALF_ANGLE, _LEAST_SQUARE_PX = 1.05, 6.0


@dataclass(frozen=True, eq=False)
class Carried:
    """Light or board on an arm, shown to cameras.

    Attributes:
        offset: Its middle in the wrist's frame, shape (3,) [m].
        axis: Direction that it faces there.
        least_cosine: Of the angle between that and a camera.
        rim: Places there that have to be in view with the middle, shape (k, 3) [m].
        square: Side of the squares of a board [m]; 0 for the light.
    """

    offset: NDArray[np.float64]
    axis: NDArray[np.float64]
    least_cosine: float
    rim: NDArray[np.float64]
    square: float


def carried(cell: Cell, board: Target | None) -> Carried:
    """Return the light of a cell, or a board."""
    if board is None:
        axis = np.array(cell.led.axis) / np.linalg.norm(cell.led.axis)
        least_cosine = float(np.cos(min(cell.led.half_angle - _FACING_MARGIN, np.pi)))
        return Carried(np.array(cell.led.offset), axis, least_cosine, np.zeros((0, 3)), 0.0)
    rotation, position = board.pose()
    half = 0.5 * board.size * (np.array(board.corners) + 1.0)
    rim = position + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ rotation[:, :2].T
    return Carried(position, rotation[:, 2], float(np.cos(_BOARD_HALF_ANGLE - _FACING_MARGIN)), rim, board.size)


@dataclass(frozen=True, eq=False)
class Candidate:
    """Pose of the wrist with the place of the light.

    Attributes:
        light: Position of the light, or of the middle of the board, in ``world``, shape (3,) [m].
        wrist: Pose of the wrist in ``world``.
    """

    light: NDArray[np.float64]
    wrist: pin.SE3


def candidates(
    shown: Carried, common: CommonView, views: Sequence[View], max_tilt_rad: float, seed: int, draws: int
) -> Iterator[Candidate]:
    """Candidates, space-filling in light position and orientation together.

    The light's outward axis points where the largest angle to a camera is least, tilted by up to ``max_tilt_rad`` to
    any side as long as it shines at all cameras, and the wrist is turned about that axis by any angle. Positions out
    of reach or out of an image are left out.

    Args:
        shown: Light or board.
        common: Where it can be seen, and shall be.
        views: Cameras that shall see it.
        max_tilt_rad: Largest tilt [rad].
        seed: Of the scrambled Halton sequence.
        draws: Length of the sequence.
    """
    offset, axis = shown.offset, shown.axis
    sequence = qmc.Halton(6, seed=seed)
    for _ in range(0, draws, _BLOCK):
        drawn = sequence.random(_BLOCK)
        lights = common.lower + drawn[:, :3] * (common.upper - common.lower)
        for k in np.flatnonzero(common.holds(lights)):
            light, s = lights[k], drawn[k]
            towards, best = facing(light, views)
            outward = _tilted(best, np.sqrt(s[3]) * max_tilt_rad, s[4])
            if (towards @ outward).min() < shown.least_cosine:
                continue
            aim = pin.Quaternion.FromTwoVectors(axis, outward).matrix()
            rotation = aim @ pin.exp3(axis * (2.0 * np.pi * s[5]))
            wrist = pin.SE3(rotation, light - rotation @ offset)
            if _distinct(shown, wrist, views):
                yield Candidate(light, wrist)


def held(shown: Carried, wrists: Iterable[pin.SE3], views: Sequence[View], max_tilt_rad: float) -> Iterator[Candidate]:
    """Candidates of an arm that cannot turn its wrist freely: as it holds the light, if that faces all cameras.

    Args:
        shown: Light or board.
        wrists: Poses of the wrist in ``world`` with the light in view.
        views: Cameras that shall see it.
        max_tilt_rad: Largest tilt away from where it faces all cameras best [rad].
    """
    for wrist in wrists:
        light, outward = wrist.act(shown.offset), wrist.rotation @ shown.axis
        towards, best = facing(light, views)
        turned = (towards @ outward).min() >= shown.least_cosine and best @ outward >= np.cos(max_tilt_rad)
        if turned and _distinct(shown, wrist, views):
            yield Candidate(light, wrist)


def _distinct(shown: Carried, wrist: pin.SE3, views: Sequence[View]) -> bool:
    """Whether all cameras see the rim, and the squares of a board large enough."""
    for view in views:
        towards = view.position - wrist.act(shown.offset)
        across = view.lens.fx * shown.square * float(towards @ wrist.rotation @ shown.axis) / float(towards @ towards)
        if shown.square and across < _LEAST_SQUARE_PX:
            return False
        if not view.sees(shown.rim @ wrist.rotation.T + wrist.translation).all():
            return False
    return True


def _tilted(direction: NDArray[np.float64], angle: float, turn: float) -> NDArray[np.float64]:
    """Return a direction ``angle`` away from another, to the side given by ``turn`` in 0..1."""
    basis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).matrix()
    phi = 2.0 * np.pi * turn
    local = np.array([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)])
    return np.asarray(basis @ local)
