"""Pneumatic grippers: jaws travel at a fixed rate, press with limited force, and stop at an object."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_cell.link import JawObject
from im_cell.robot import Gripper


class GripperJaws:
    """The jaws of all grippers.

    Jaws close on an object of width ``w`` and stiffness ``k`` until ``k (w - opening)`` is the force allowed; with less
    force allowed later, the object pushes them apart.

    Attributes:
        opening: Of the jaws, shape (n,) [m].
        force: On what is between them, shape (n,) [N].
    """

    def __init__(self, gripper: Gripper, count: int) -> None:
        self._gripper = gripper
        self._objects: list[JawObject | None] = [None] * count
        self._wanted = [gripper.initial] * count
        self._allowed = [gripper.force] * count
        self._told = b"", b""
        self._resting = False
        self.opening = np.full(count, gripper.initial)
        self.force = np.zeros(count)

    def put(self, objects: Sequence[JawObject | None]) -> None:
        """Set the object between the jaws of each gripper; a wide object pushes the jaws apart."""
        self._objects = list(objects)
        self._resting = False
        self.step(0.0)

    def held(self) -> tuple[JawObject | None, ...]:
        """Return the object held by each gripper, pressed between the jaws."""
        return tuple(
            held if force > 0.0 else None for held, force in zip(self._objects, self.force.tolist(), strict=True)
        )

    def command(self, opening: NDArray[np.float64], force: NDArray[np.float64]) -> None:
        """Set the wanted openings [m] and the forces allowed [N], shape (n,) each.

        Values out of range are cut to it, NaN changes nothing.
        """
        told = opening.tobytes(), force.tobytes()
        if told == self._told:
            return
        self._told, self._resting = told, False
        g = self._gripper
        for i, (wanted, allowed) in enumerate(zip(opening.tolist(), force.tolist(), strict=True)):
            if not math.isnan(wanted):
                self._wanted[i] = min(max(wanted, 0.0), g.stroke)
            if not math.isnan(allowed):
                self._allowed[i] = min(max(allowed, 0.0), g.force)

    def step(self, dt: float) -> bool:
        """Let ``dt`` [s] pass; the valves keep the position without motor power.

        Returns:
            Whether anything has changed.
        """
        if self._resting:
            return False
        before = self.opening.tobytes(), self.force.tobytes()
        moved = [self._move(i, before, self._gripper.rate * dt) for i, before in enumerate(self.opening.tolist())]
        self.opening = np.array([opening for opening, _ in moved])
        self.force = np.array([force for _, force in moved])
        self._resting = dt > 0.0 and before == (self.opening.tobytes(), self.force.tobytes())
        return not self._resting

    def _move(self, i: int, before: float, reach: float) -> tuple[float, float]:
        """Return opening and force after a travel of the jaws by at most ``reach``."""
        after = before + min(max(self._wanted[i] - before, -reach), reach)
        held = self._objects[i]
        if held is None:
            return after, 0.0
        squeezed = held.width - self._allowed[i] / held.stiffness  # no closer does the force bring them
        after = min(max(after, squeezed), self._gripper.stroke)
        return after, max(0.0, held.stiffness * (held.width - after)) if after < self._gripper.stroke else 0.0
