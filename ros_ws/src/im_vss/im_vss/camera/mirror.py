"""Reflections of the lights in flat metal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.robot.scenery import Mirror

Array = NDArray[np.float64]

_AXES = {"x": 0, "y": 1, "z": 2}
_SKIN_M = 0.002


@dataclass(frozen=True)
class Reflection:
    """A light seen in a mirror: its virtual position [m] and axis, and where the mirror throws it back [m]."""

    position: Array
    axis: Array
    bounce: Array


def reflect(
    mirror: Mirror, rotation: Array, origin: Array, position: Array, axis: Array, eye: Array
) -> Reflection | None:
    """The image of a light in a mirror.

    Args:
        mirror: The mirror.
        rotation: Rotation of its link -> world, shape (3, 3).
        origin: Origin of its link in the world, shape (3,) [m].
        position: The light in the world, shape (3,) [m].
        axis: Direction the light faces, shape (3,).
        eye: Optical centre of the camera, shape (3,) [m].

    Returns:
        The reflection, None where the mirror throws nothing from the light to the camera.
    """
    across = _AXES[mirror.axis]
    normal, centre = rotation[:, across], origin + rotation @ np.array(mirror.center)
    height, eye_height = normal @ (position - centre), normal @ (eye - centre)
    if height <= _SKIN_M or eye_height <= _SKIN_M:
        return None
    bounce = position + (eye - position) * height / (height + eye_height)
    bounce = bounce - normal * (normal @ (bounce - centre))
    within = np.delete(rotation.T @ (bounce - centre), across)
    if np.any(np.abs(within) > 0.5 * np.array(mirror.size)):
        return None
    return Reflection(
        position - 2.0 * height * normal, axis - 2.0 * (normal @ axis) * normal, bounce + _SKIN_M * normal
    )
