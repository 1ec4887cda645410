"""The arms' rigid-body dynamics, with and without objects in the grippers."""

from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.link import JawObject
from im_cell.robot import Cell, urdf


class Dynamics:
    """pinocchio's model of the cell.

    Attributes:
        bare: Without loads, as pybullet has it.
        bare_data: Its workspace.
        model: With loads; the same object as ``bare`` while nothing is held.
        data: Its workspace.
        wrists: Joint index and placement of the frame on that joint's link, of each tip with a force-torque sensor.
        wrist_forces: What the arm exerts on those links, after :func:`pinocchio.rnea` with ``model`` and ``data``.
    """

    def __init__(self, cell: Cell) -> None:
        full = pin.buildModelFromXML(urdf(cell, shapes=False))
        self.wrists, self._jaws = (_places(full, cell.devices(kind).values()) for kind in ("force", "gripper"))
        self._reach = cell.gripper.reach
        self.bare = pin.buildModelFromXML(urdf(cell, shapes=False, frames=False))
        self.bare.gravity.linear = np.array([0.0, 0.0, -cell.gravity])
        self.bare_data = self.bare.createData()
        self._held: tuple[JawObject | None, ...] = (None,) * len(self._jaws)
        self._use(self.bare, self.bare_data)

    @property
    def loaded(self) -> bool:
        """Whether a gripper holds something."""
        return self.model is not self.bare

    def reflect(self, inertias: NDArray[np.float64]) -> None:
        """Set an inertia of each joint's own, as of a rotor seen through the gear, shape (n,)."""
        self.bare.armature = inertias

    def carry(self, held: Sequence[JawObject | None]) -> None:
        """Set the load of each gripper: a cube between the jaws."""
        if tuple(held) == self._held:
            return
        self._held = tuple(held)
        if not any(self._held):
            self._use(self.bare, self.bare_data)
            return
        model = self.bare.copy()
        for (joint, wrist), load in zip(self._jaws, self._held, strict=True):
            if load is not None and load.mass > 0.0:
                cube = pin.Inertia.FromBox(load.mass, load.width, load.width, load.width)
                jaws = wrist * pin.SE3(np.eye(3), np.array([0.0, 0.0, self._reach]))
                model.inertias[joint] = model.inertias[joint] + jaws.act(cube)
        self._use(model, model.createData())

    def _use(self, model: pin.Model, data: pin.Data) -> None:
        self.model, self.data = model, data
        self.wrist_forces = [data.f[joint] for joint, _ in self.wrists]


def _places(model: pin.Model, tips: Iterable[str]) -> list[tuple[int, pin.SE3]]:
    """Return the joint that carries each tip, and where the tip is on its link."""
    frames = [model.frames[model.getFrameId(tip)] for tip in tips]
    return [(int(frame.parentJoint), frame.placement.copy()) for frame in frames]
