"""Places and views of cameras, and the best turn of a light for all cameras."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Intrinsics
from im_core.errors import NotFoundError, StateError
from im_mcs.collision.bodies import ancestors
from im_mcs.model import CellModel

# What nominal cameras may be off: true ones see a light that nominal ones see with these margins.
_MARGIN_PX = 20.0
# A light whose image has a larger radius is a disc, not a spot.
_LARGEST_SPOT_PX = 6.7
_OPPOSITE = 1e-9


@dataclass(frozen=True)
class View:
    """Nominal camera at the place in ``world``.

    Attributes:
        name: Its name.
        rotation: ``world`` -> optical frame, shape (3, 3).
        position: Optical centre, shape (3,) [m].
        lens: Image size and pinhole.
        nearest: Least distance of what it shall see [m].
    """

    name: str
    rotation: NDArray[np.float64]
    position: NDArray[np.float64]
    lens: Intrinsics
    nearest: float

    def sees(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points, shape (n, 3) [m], lie well inside the image and not too near, shape (n,)."""
        x, y, z = ((points - self.position) @ self.rotation.T).T
        ahead = z > 1e-6
        depth = np.where(ahead, z, 1.0)
        u, v = self.lens.fx * x / depth + self.lens.cx, self.lens.fy * y / depth + self.lens.cy
        across = (u >= _MARGIN_PX) & (u <= self.lens.width - 1.0 - _MARGIN_PX)
        down = (v >= _MARGIN_PX) & (v <= self.lens.height - 1.0 - _MARGIN_PX)
        far: NDArray[np.bool_] = np.linalg.norm(points - self.position, axis=1) >= self.nearest
        return np.asarray(ahead & across & down & far)


def stand(model: CellModel, names: Sequence[str], group: str, joints: Sequence[str], diameter: float) -> list[View]:
    """Return cameras at the places during a move of a group, with all other joints at home.

    Args:
        model: Kinematics and the cameras.
        names: Names of the cameras.
        group: Name of the group.
        joints: Its joints.
        diameter: Of the light that they shall see; 0: no light [m].

    Raises:
        NotFoundError: There is no such camera.
        StateError: A camera rides on the group.
    """
    views = []
    for name in names:
        if name not in model.cell.cameras:
            raise NotFoundError(kind="camera", name=name, known=model.cell.cameras)
        camera = model.cell.cameras[name]
        rotation, translation = camera.pose()
        parent = pin.SE3.Identity()
        if camera.parent != "world":
            if rides_on(model, camera.parent, joints):
                raise StateError(
                    f"camera '{name}' rides on {camera.parent}, which group '{group}' moves; another arm has to carry"
                    " the light"
                )
            parent = model.pose(model.cell.home, camera.parent)
        position = parent.act(-rotation.T @ translation)
        lens = camera.intrinsics
        nearest = lens.fx * diameter / (2.0 * _LARGEST_SPOT_PX)
        views.append(View(name, rotation @ parent.rotation.T, np.asarray(position), lens, nearest))
    return views


def rides_on(model: CellModel, frame: str, joints: Sequence[str]) -> bool:
    """Whether any of the joints moves a frame."""
    carriers = ancestors(model, int(model.pin.frames[model.frame_id(frame)].parentJoint))
    return any(model.index(joint) + 1 in carriers for joint in joints)


def facing(light: NDArray[np.float64], views: Sequence[View]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions from a light to the cameras, shape (c, 3), and the one with the least largest angle, (3,).

    The latter is the middle of two of the directions, or equally far from three of them.
    """
    towards = np.array([view.position - light for view in views])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    tried = [towards[0]]
    for a, b in combinations(towards, 2):
        across = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])  # for cameras on opposite sides
        tried.append(a + b if np.linalg.norm(a + b) > _OPPOSITE else across)
    for a, b, c in combinations(towards, 3):
        normal = np.cross(b - a, c - a)
        tried += [normal, -normal]
    directions = np.array([each / np.linalg.norm(each) for each in tried if np.linalg.norm(each) > 0.0])
    return towards, np.asarray(directions[int(np.argmax((directions @ towards.T).min(axis=1)))])
