"""The pybullet world: the cell's links as one multibody, floor and table as obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from im_cell.robot import Cell, Gripper, urdf
from im_cell.robot.urdf import fixed_joint
from im_core.errors import DataError
from im_sim.bodies import FIXED, HULLS, LINKS, FreeBodies
from im_sim.urdf_loader import load_urdf
from im_sim.world_joints import WorldJoints

_ITERATIONS = 200  # with pybullet's 50 the friction of jaws is not solved: what they hold creeps and turns
# Share of what pads have slipped that a step takes back, as soft pads do: with pybullet's 0.2 the arm trembles.
_PAD_ERP = 0.02
_CENTRING_N = 1e4  # the jaws travel together: what keeps them in the middle gives way to nothing


@dataclass(frozen=True)
class _Jaws:
    """Links of a gripper: the one that carries it, its palm, the first jaw and the second one, by pybullet's index."""

    carrier: int
    palm: int
    first: int
    second: int

    @property
    def parts(self) -> tuple[int, int, int]:
        return self.first, self.second, self.palm


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
            fixedTimeStep=dt, numSubSteps=0, deterministicOverlappingPairs=1, numSolverIterations=_ITERATIONS,
            frictionERP=_PAD_ERP, **self._options,
        )  # fmt: skip
        obstacles = []
        for box in cell.obstacles:
            half = [edge / 2.0 for edge in box.size]
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, **self._options)
            obstacles.append(pybullet.createMultiBody(0.0, shape, basePosition=box.center, **self._options))
        text = urdf(cell, frames=False, grippers=bool(cell.objects))
        self.body = load_urdf(text, self.client, pybullet.URDF_USE_INERTIA_FROM_FILE)
        self._indices = self._joint_indices(cell)
        self._joints = [self._indices[name] for name in cell.joint_names]
        self._access = WorldJoints(self.client, self.body, self._joints)
        self.bodies = FreeBodies(cell.objects, self.client)
        self._jaws = self._find_jaws(cell) if cell.objects else []
        self._make_exact(cell)
        self._make_jaws(cell.gripper)
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
        return self._access.state()

    def step(self, tau: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the state after one step under joint torques, shape (n,) [Nm or N]."""
        return self._access.step(tau)

    def contact_wrenches(self, joints: Sequence[int]) -> list[list[float]]:
        """Return force and moment about the origin of the contacts of the child links of some joints, with grippers.

        Args:
            joints: By rank, after the last step.

        Returns:
            Of each joint, shape (6,) [N, Nm]; empty if nothing is touched.
        """
        wrenches: list[list[float]] = [[] for _ in joints]
        if self._access.touch():
            points = pybullet.getContactPoints(self.body, physicsClientId=self.client)
            ranks = {self._joints[joint]: rank for rank, joint in enumerate(joints)}
            ranks |= {part: ranks[jaws.carrier] for jaws in self._jaws if jaws.carrier in ranks for part in jaws.parts}
            for point in points:
                if (rank := ranks.get(point[3])) is not None:
                    _add_contact(wrenches[rank], point)
        return wrenches

    def jaws(self) -> tuple[list[float], list[float]]:
        """Return openings [m] and forces between the jaws [N] of each gripper."""
        states = [pybullet.getJointState(self.body, jaws.second, self.client) for jaws in self._jaws]
        pressed = [0.0] * len(states)
        if self._access.touch():
            pressed = [
                min(sum((p[9] for p in self._touches(jaw)), 0.0) for jaw in (jaws.first, jaws.second))
                for jaws in self._jaws
            ]
        return [state[0] for state in states], pressed

    def drive_jaws(self, gripper: int, opening: float, speed: float, force: float) -> None:
        """Drive the jaws of a gripper apart, from an opening [m] at ``speed`` [m/s] with at most ``force`` [N]."""
        jaws = self._jaws[gripper]
        pybullet.setJointMotorControl2(
            self.body, jaws.second, pybullet.VELOCITY_CONTROL, targetVelocity=speed, force=force, **self._options
        )
        pybullet.setJointMotorControl2(
            self.body, jaws.first, pybullet.POSITION_CONTROL, targetPosition=opening / 2.0, targetVelocity=speed / 2.0,
            positionGain=0.3, velocityGain=1.0, force=_CENTRING_N, **self._options,
        )  # fmt: skip

    def _touches(self, link: int) -> Sequence[Any]:
        found: Sequence[Any] = pybullet.getContactPoints(bodyA=self.body, linkIndexA=link, **self._options)
        return found

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

    def _joint_indices(self, cell: Cell) -> dict[str, int]:
        count = pybullet.getNumJoints(self.body, **self._options)
        infos = [pybullet.getJointInfo(self.body, joint, **self._options) for joint in range(count)]
        indices = {info[1].decode(): info[0] for info in infos}
        missing = [name for name in cell.joint_names if name not in indices]
        if missing or (count != len(cell.joints) and not cell.objects):
            raise DataError(f"pybullet read {count} joints from the URDF of {len(cell.joints)}, without {missing}")
        return indices

    def _find_jaws(self, cell: Cell) -> list[_Jaws]:
        carriers = dict(zip((link.name for link in cell.links), self._joints, strict=True))
        found = []
        for name, tip in cell.devices("gripper").items():
            group = name.removesuffix("_gripper")
            joints = (fixed_joint(f"{group}_palm"), f"{group}_jaw", name)
            found.append(_Jaws(carriers[cell.tree.carrier(tip).parent], *(self._indices[joint] for joint in joints)))
        return found

    def _make_jaws(self, gripper: Gripper) -> None:
        """Let free bodies meet palms and jaws, and every link but the last ones, whose hulls enclose grippers."""
        for jaws in self._jaws:
            pybullet.setCollisionFilterGroupMask(self.body, jaws.carrier, HULLS, FIXED, **self._options)
            for link in jaws.parts:
                pybullet.setCollisionFilterGroupMask(self.body, link, LINKS, FIXED, **self._options)
                pybullet.changeDynamics(
                    self.body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, lateralFriction=1.0,
                    restitution=0.0, frictionAnchor=1, **self._options,
                )  # fmt: skip
            pybullet.resetJointState(self.body, jaws.first, gripper.initial / 2.0, 0.0, **self._options)
            pybullet.resetJointState(self.body, jaws.second, gripper.initial, 0.0, **self._options)

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
            pybullet.setCollisionFilterGroupMask(self.body, joint, LINKS, FIXED, **self._options)
        pybullet.changeDynamics(self.body, -1, linearDamping=0.0, angularDamping=0.0, **self._options)


def _add_contact(wrench: list[float], point: Sequence[Any]) -> None:
    """Add a contact point as reported by pybullet: normal force, then two friction forces with the directions."""
    normal, first, second = point[9], point[10], point[12]
    x, y, z = point[6]
    f, g, h = (normal * n + first * a + second * b for n, a, b in zip(point[7], point[11], point[13], strict=True))
    added = f, g, h, y * h - z * g, z * f - x * h, x * g - y * f
    wrench[:] = map(sum, zip(wrench, added, strict=True)) if wrench else added
