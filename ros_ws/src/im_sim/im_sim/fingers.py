"""Jaws with shape: links of the arms that hold a free body by contact and friction."""

import numpy as np

from im_cell.link import JawObject
from im_cell.robot import Gripper
from im_sim.grippers import GripperJaws
from im_sim.world import World

_THERE_M, _DIGITS = 1e-4, 4


class FingerJaws(GripperJaws):
    """The jaws of all grippers in pybullet; they travel and press as :class:`GripperJaws` do."""

    def __init__(self, gripper: Gripper, count: int, world: World) -> None:
        super().__init__(gripper, count)
        self._world = world
        self._drives = [(0.0, 0.0, -1.0)] * count
        self.step(0.0)

    def held(self) -> tuple[JawObject | None, ...]:
        """Return no object: what is held is in the world, and presses on the jaws there."""
        return (None,) * len(self._drives)

    def step(self, dt: float) -> bool:
        """Read the jaws after ``dt`` [s] of the world, and drive them on; whether anything has changed."""
        openings, forces = self._world.jaws()
        changed = openings != self.opening.tolist() or forces != self.force.tolist()
        self.opening, self.force = np.array(openings), np.array(forces)
        for rank, opening in enumerate(openings):
            away, rate = self._wanted[rank] - opening, self._gripper.rate
            speed = min(max(away / dt, -rate), rate) if abs(away) > _THERE_M and dt > 0.0 else 0.0
            drive = (opening if speed else round(opening, _DIGITS), speed, self._allowed[rank])
            if drive != self._drives[rank]:
                self._drives[rank] = drive
                self._world.drive_jaws(rank, *drive)
        return changed
