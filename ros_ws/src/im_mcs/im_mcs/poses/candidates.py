"""Candidate poses: the light anywhere in the workspace, turned towards the cameras."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.stats import qmc

from im_core.robot import Camera, Cell

_MARGIN_PX = 20.0


@dataclass(frozen=True)
class Volume:
    """A box of the world, to be filled with lights.

    Attributes:
        lower: Corner, shape (3,) [m].
        upper: Opposite corner, shape (3,) [m].
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """A pose of the wrist and where it brings the light.

    Attributes:
        light: Position of the light in ``world``, shape (3,) [m].
        wrist: Pose of the wrist in ``world``.
    """

    light: NDArray[np.float64]
    wrist: pin.SE3


def candidates(
    cell: Cell, volume: Volume, cameras: list[Camera], max_tilt_rad: float, seed: int
) -> Iterator[Candidate]:
    """Endless candidates, space-filling in light position and orientation together.

    The light's outward axis points at the middle of the cameras, tilted by up to ``max_tilt_rad`` to any side, and the
    wrist is turned about that axis by any angle. Positions that lie outside the image of a camera are left out.

    Args:
        cell: Light.
        volume: Where it shall be.
        cameras: Cameras that shall see it (nominal).
        max_tilt_rad: Largest tilt [rad].
        seed: Of the scrambled Halton sequence.
    """
    middle = np.mean([camera.position for camera in cameras], axis=0)
    offset, axis = np.array(cell.led.offset), np.array(cell.led.axis)
    sequence = qmc.Halton(6, seed=seed)
    while True:
        s = sequence.random(1)[0]
        light = volume.lower + s[:3] * (volume.upper - volume.lower)
        if not all(_in_image(camera, light) for camera in cameras):
            continue
        outward = _tilted((middle - light) / np.linalg.norm(middle - light), np.sqrt(s[3]) * max_tilt_rad, s[4])
        aim = pin.Quaternion.FromTwoVectors(axis, outward).matrix()
        turn = pin.exp3(axis / np.linalg.norm(axis) * (2.0 * np.pi * s[5]))
        rotation = aim @ turn
        yield Candidate(light, pin.SE3(rotation, light - rotation @ offset))


def _tilted(direction: NDArray[np.float64], angle: float, turn: float) -> NDArray[np.float64]:
    """A direction ``angle`` away from another, to the side given by ``turn`` in 0..1."""
    basis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).matrix()
    phi = 2.0 * np.pi * turn
    local = np.array([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)])
    return np.asarray(basis @ local)


def _in_image(camera: Camera, point: NDArray[np.float64]) -> bool:
    """Whether a point lies inside the image by the nominal pinhole model, with a margin for what is not known."""
    rotation, translation = camera.pose()
    x, y, z = rotation @ point + translation
    if z <= 0.0:
        return False
    lens = camera.intrinsics
    u, v = lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy
    return bool(_MARGIN_PX <= u <= lens.width - _MARGIN_PX and _MARGIN_PX <= v <= lens.height - _MARGIN_PX)
