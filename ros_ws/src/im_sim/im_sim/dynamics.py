"""The arms' rigid-body dynamics, with and without what the grippers hold."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from im_core.robot import Cell, urdf
from im_core.testbed_link import JawObject


class Dynamics:
    """pinocchio's model of the cell.

    Attributes:
        bare: Without loads, as pybullet has it.
        bare_data: Its workspace.
        model: With loads; the same object as ``bare`` while nothing is held.
        data: Its workspace.
        wrists: Joint index and placement of the wrist frame on that joint's link, of each side.
    """

    def __init__(self, cell: Cell) -> None:
        full = pin.buildModelFromXML(urdf(cell, shapes=False))
        frames = [full.frames[full.getFrameId(f"{side}_wrist")] for side in cell.sides]
        self.wrists = [(int(frame.parentJoint), frame.placement.copy()) for frame in frames]
        self._reach = cell.gripper.reach
        self.bare = pin.buildModelFromXML(urdf(cell, shapes=False, frames=False))
        self.bare.gravity.linear = np.array([0.0, 0.0, -cell.gravity])
        self.bare_data = self.bare.createData()
        self.model, self.data = self.bare, self.bare_data
        self._held: tuple[JawObject | None, ...] = (None,) * len(self.wrists)

    @property
    def loaded(self) -> bool:
        """Whether a gripper holds something."""
        return self.model is not self.bare

    def carry(self, held: Sequence[JawObject | None]) -> None:
        """Say what each gripper holds: a cube between the jaws."""
        if tuple(held) == self._held:
            return
        self._held = tuple(held)
        if not any(self._held):
            self.model, self.data = self.bare, self.bare_data
            return
        self.model = self.bare.copy()
        for (joint, wrist), load in zip(self.wrists, self._held, strict=True):
            if load is not None and load.mass > 0.0:
                cube = pin.Inertia.FromBox(load.mass, load.width, load.width, load.width)
                jaws = wrist * pin.SE3(np.eye(3), np.array([0.0, 0.0, self._reach]))
                self.model.inertias[joint] = self.model.inertias[joint] + jaws.act(cube)
        self.data = self.model.createData()
