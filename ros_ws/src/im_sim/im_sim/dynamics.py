"""The arms' rigid-body dynamics, with and without objects in the grippers."""

from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.link import JawObject
from im_cell.robot import PALM_KGM2, Cell, urdf

#: Of both jaws about their middle, at a medium opening.
_JAWS_KGM2 = 1e-4


class Dynamics:
    """pinocchio's model of the cell.

    Attributes:
        bare: Without loads, as pybullet has it.
        bare_data: Its workspace.
        model: With loads; the same object as ``bare`` while nothing is held.
        data: Its workspace.
        wrists: Joint index and placement of the frame on that joint's link, of each tip with a force-torque sensor.
        gripper_joints: Indices of the joints whose links carry grippers.
        wrist_forces: What the arm exerts on those links, after :func:`pinocchio.rnea` with ``model`` and ``data``.
    """

    def __init__(self, cell: Cell) -> None:
        full = pin.buildModelFromXML(urdf(cell, shapes=False))
        self.wrists, self._jaws = (_places(full, cell.devices(kind).values()) for kind in ("force", "gripper"))
        self.gripper_joints = sorted({joint for joint, _ in self._jaws})
        self._reach = cell.gripper.reach
        self.bare = pin.buildModelFromXML(urdf(cell, shapes=False, frames=False))
        self.bare.gravity.linear = np.array([0.0, 0.0, -cell.gravity])
        if cell.objects:  # pybullet has jaws then, and palms that are rotors' stand-ins
            jaws = pin.Inertia(2.0 * cell.gripper.jaw_mass, np.array([0.0, 0.0, self._reach]), _JAWS_KGM2 * np.eye(3))
            self._add(jaws)
        self._true = self.bare
        if cell.objects:
            self._true = self.bare.copy()
            self._add(pin.Inertia(0.0, np.zeros(3), PALM_KGM2 * np.eye(3)))
        self.bare_data = self.bare.createData()
        self._held: tuple[JawObject | None, ...] = (None,) * len(self._jaws)
        self._use(self._true, self.bare_data if self._true is self.bare else self._true.createData())

    @property
    def loaded(self) -> bool:
        """Whether a gripper holds something."""
        return self.model is not self.bare

    def reflect(self, inertias: NDArray[np.float64]) -> None:
        """Set an inertia of each joint's own, as of a rotor seen through the gear, shape (n,)."""
        self.bare.armature = inertias
        self._true.armature = inertias

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

    def contact_torques(
        self, q: NDArray[np.float64], contacts: Sequence[Sequence[float]]
    ) -> NDArray[np.float64] | None:
        """Return the torques at the joints by which contacts of grippers are felt, shape (n,); None without any.

        Args:
            q: Positions, shape (n,) [rad or m].
            contacts: Wrenches about the origin on the links that carry grippers, as ``gripper_joints``, shape (6,) each
                [N, Nm]; empty without a contact.
        """
        if not any(contacts):
            return None
        torques = np.zeros(self.bare.nv)
        pin.forwardKinematics(self.bare, self.bare_data, q)
        for joint, wrench in zip(self.gripper_joints, contacts, strict=True):
            if wrench:
                local = self.bare_data.oMi[joint].actInv(pin.Force(np.array(wrench)))
                torques += pin.computeJointJacobian(self.bare, self.bare_data, q, joint).T @ local.vector
        return torques

    def _add(self, inertia: pin.Inertia) -> None:
        """Add an inertia in the frame of each gripper to the model without loads."""
        for joint, wrist in self._jaws:
            self.bare.inertias[joint] = self.bare.inertias[joint] + wrist.act(inertia)

    def _use(self, model: pin.Model, data: pin.Data) -> None:
        self.model, self.data = model, data
        self.wrist_forces = [data.f[joint] for joint, _ in self.wrists]


def _places(model: pin.Model, tips: Iterable[str]) -> list[tuple[int, pin.SE3]]:
    """Return the joint that carries each tip, and where the tip is on its link."""
    frames = [model.frames[model.getFrameId(tip, pin.FrameType.BODY)] for tip in tips]
    return [(int(frame.parentJoint), frame.placement.copy()) for frame in frames]
