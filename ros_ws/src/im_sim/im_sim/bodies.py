"""Free bodies in pybullet: their shapes, places, and contact."""

from collections.abc import Sequence

import numpy as np
import pybullet
from numpy.typing import NDArray

from im_cell.robot import FreeBody

#: Collision groups: links and what is fixed to the world as Bullet has them, free bodies, hulls of grippers. pybullet
#: lets two shapes meet if one of them has the other's group in its mask.
LINKS, FIXED, BODIES, HULLS = 1, 2, 4, 8
_NO_BODIES = np.empty((0, 7))


class FreeBodies:
    """Free bodies of a cell in a pybullet client."""

    def __init__(self, bodies: Sequence[FreeBody], client: int) -> None:
        self._options = {"physicsClientId": client}
        self.ids = [self._make(body) for body in bodies]

    def __len__(self) -> int:
        """How many there are."""
        return len(self.ids)

    def poses(self) -> NDArray[np.float64]:
        """Return position [m] and quaternion x, y, z, w of each, shape (m, 7)."""
        if not self.ids:
            return _NO_BODIES
        return np.array([sum(pybullet.getBasePositionAndOrientation(body, **self._options), ()) for body in self.ids])

    def place(self, rank: int, pose: NDArray[np.float64]) -> None:
        """Put a body somewhere, at rest: position [m] and quaternion x, y, z, w, shape (7,)."""
        body = self.ids[rank]
        pybullet.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist(), **self._options)
        pybullet.resetBaseVelocity(body, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), **self._options)

    def _make(self, body: FreeBody) -> int:
        half = [edge / 2.0 for edge in body.size]
        if body.kind == "box":
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, **self._options)
            seen = {"shapeType": pybullet.GEOM_BOX, "halfExtents": half}
        else:
            radius, height = half[0], body.size[2]
            shape = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, radius=radius, height=height, **self._options)
            seen = {"shapeType": pybullet.GEOM_CYLINDER, "radius": radius, "length": height}
        drawn = pybullet.createVisualShape(rgbaColor=[*body.color, 1.0], **seen, **self._options)
        made: int = pybullet.createMultiBody(
            body.mass,
            shape,
            drawn,
            basePosition=body.start[:3].tolist(),
            baseOrientation=body.start[3:].tolist(),
            **self._options,
        )
        pybullet.changeDynamics(
            made,
            -1,
            lateralFriction=body.friction,
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_ENABLE_SLEEPING,
            **self._options,
        )
        pybullet.setCollisionFilterGroupMask(made, -1, BODIES, ~HULLS, **self._options)
        return made
