"""The pybullet world: the cell's links as one multibody, floor and table as obstacles."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from im_cell.robot import Cell, urdf
from im_core.errors import DataError
from im_sim.urdf_loader import load_urdf

_LINK, _OBSTACLE = 1, 2  # Bullet's default and static collision groups


@dataclass(frozen=True)
class Contact:
    """Where something is touched.

    Attributes:
        position: In the world, shape (3,) [m].
        force: On the link, shape (3,) [N].
    """

    position: NDArray[np.float64]
    force: NDArray[np.float64]


class World:
    """Pybullet client (DIRECT) with the cell inside, driven by joint torques.

    Args:
        cell: Links, joints, obstacles.
        dt: Length of a step [s].
    """

    def __init__(self, cell: Cell, dt: float) -> None:
        self.client = pybullet.connect(pybullet.DIRECT)
        self._options = {"physicsClientId": self.client}
        pybullet.setGravity(0.0, 0.0, -cell.gravity, **self._options)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=dt, numSubSteps=0, deterministicOverlappingPairs=1, **self._options
        )
        obstacles = []
        for box in cell.obstacles:
            half = [edge / 2.0 for edge in box.size]
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, **self._options)
            obstacles.append(pybullet.createMultiBody(0.0, shape, basePosition=box.center, **self._options))
        self.body = load_urdf(urdf(cell, frames=False), self.client, pybullet.URDF_USE_INERTIA_FROM_FILE)
        self._joints = self._moving_joints(cell)
        self._state = struct.Struct(f"{2 * len(self._joints)}d")
        self._make_exact(cell)
        self.reset(cell.home, np.zeros(len(self._joints)))
        self._part(obstacles)

    def _part(self, obstacles: Sequence[int]) -> None:
        """Let links and obstacles that overlap at home pass each other: a foot may be let into the floor."""
        for obstacle in obstacles:
            for point in pybullet.getClosestPoints(self.body, obstacle, 0.0, **self._options):
                pybullet.setCollisionFilterPair(self.body, obstacle, point[3], -1, 0, **self._options)

    def reset(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Set positions and velocities, shape (n,) each [rad or m, by s]."""
        for joint, position, velocity in zip(self._joints, q, v, strict=True):
            pybullet.resetJointState(self.body, joint, position, velocity, **self._options)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities, shape (n,) each [rad or m, by s]."""
        q, v, _, _ = zip(*pybullet.getJointStates(self.body, self._joints, self.client), strict=True)
        both = np.frombuffer(self._state.pack(*q, *v))  # in half the time of an array made from numbers
        return both[: len(q)], both[len(q) :]

    def step(self, tau: NDArray[np.float64]) -> None:
        """One step under joint torques, shape (n,) [Nm or N]."""
        pybullet.setJointMotorControlArray(
            self.body, self._joints, pybullet.TORQUE_CONTROL, forces=tau.tolist(), physicsClientId=self.client
        )
        pybullet.stepSimulation(self.client)

    def contacts(self, joints: Sequence[int]) -> list[list[Contact]]:
        """Return the contacts of the child links of some joints, by rank, after the last step."""
        if not pybullet.getContactPoints(self.body, physicsClientId=self.client):
            return [[] for _ in joints]
        return [
            [_contact(point) for point in pybullet.getContactPoints(bodyA=self.body, linkIndexA=link, **self._options)]
            for link in (self._joints[joint] for joint in joints)
        ]

    def inverse_dynamics(
        self, q: NDArray[np.float64], v: NDArray[np.float64], a: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return pybullet's torques for a motion, shape (n,) [Nm or N]."""
        return np.array(
            pybullet.calculateInverseDynamics(self.body, q.tolist(), v.tolist(), a.tolist(), **self._options)
        )

    def close(self) -> None:
        """Disconnect."""
        pybullet.disconnect(**self._options)

    def _moving_joints(self, cell: Cell) -> list[int]:
        count = pybullet.getNumJoints(self.body, **self._options)
        infos = [pybullet.getJointInfo(self.body, joint, **self._options) for joint in range(count)]
        indices = {info[1].decode(): info[0] for info in infos}
        missing = [name for name in cell.joint_names if name not in indices]
        if missing or count != len(cell.joints):
            raise DataError(f"pybullet read {count} joints from the URDF of {len(cell.joints)}, without {missing}")
        return [indices[name] for name in cell.joint_names]

    def _make_exact(self, cell: Cell) -> None:
        """Undo the changes of pybullet to a URDF.

        Motors that hold velocity zero, damping, and a limit on speed are switched off. pybullet sets inertias that
        violate the triangle inequality, as that published for link 3, to zero: all are set again.
        """
        n = len(self._joints)
        pybullet.setJointMotorControlArray(
            self.body, self._joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * n, **self._options
        )
        for joint, link in zip(self._joints, cell.links, strict=True):
            pybullet.changeDynamics(
                self.body,
                joint,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                lateralFriction=0.5,
                restitution=0.0,
                maxJointVelocity=1e3,
                **self._options,
            )
            # In a call of its own: beside other changes pybullet ignores it.
            pybullet.changeDynamics(self.body, joint, localInertiaDiagonal=link.inertia, **self._options)
            # Links meet obstacles, not each other: no URDF_USE_SELF_COLLISION. Said here too, pairs are not looked at.
            pybullet.setCollisionFilterGroupMask(self.body, joint, _LINK, _OBSTACLE, **self._options)
        pybullet.changeDynamics(self.body, -1, linearDamping=0.0, angularDamping=0.0, **self._options)


def _contact(point: Sequence[Any]) -> Contact:
    """Read a contact point as reported by pybullet: normal force, then two friction forces with the directions."""
    position, normal = np.array(point[6]), np.array(point[7])
    force = point[9] * normal + point[10] * np.array(point[11]) + point[12] * np.array(point[13])
    return Contact(position, force)
