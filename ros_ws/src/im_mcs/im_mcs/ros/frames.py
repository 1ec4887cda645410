"""Transforms of the cell's links."""

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray

from im_core.robot import Cell
from im_mcs.model import Model
from im_mcs.ros.messages import fill_placement, time


class Frames:
    """Transforms of the cell's links.

    Args:
        cell: Joints, links and fixed frames.
        model: Kinematics; used by this object alone.
    """

    def __init__(self, cell: Cell, model: Model) -> None:
        self._model = model
        self._moving = [(joint.parent, joint.child) for joint in cell.joints]
        names = {parent for parent, _ in self._moving} | {child for _, child in self._moving}
        self._fixed = [(_parent_frame(model, name), name) for name in model.poses(cell.home) if name not in names]
        self._home = cell.home

    def moving(self, q: NDArray[np.float64], stamp_ns: int) -> list[TransformStamped]:
        """Transforms over the joints at ``q``, shape (18,)."""
        return self._transforms(self._moving, q, stamp_ns)

    def fixed(self) -> list[TransformStamped]:
        """Transforms of frames that are fixed to a link."""
        return self._transforms(self._fixed, self._home, 0)

    def _transforms(
        self, pairs: list[tuple[str, str]], q: NDArray[np.float64], stamp_ns: int
    ) -> list[TransformStamped]:
        poses = self._model.poses(q)
        poses.setdefault("world", pin.SE3.Identity())
        stamp = time(stamp_ns)
        messages = []
        for parent, child in pairs:
            message = TransformStamped(child_frame_id=child)
            message.header.frame_id, message.header.stamp = parent, stamp
            placement = poses[parent].actInv(poses[child])
            fill_placement(message.transform.translation, message.transform.rotation, placement)
            messages.append(message)
        return messages


def _parent_frame(model: Model, name: str) -> str:
    """Nearest body that a fixed frame hangs on."""
    frame = model.pin.frames[model.frame_id(name)]
    parent = model.pin.frames[frame.parentFrame]
    while parent.type != pin.FrameType.BODY and parent.name != "universe":
        parent = model.pin.frames[parent.parentFrame]
    return "world" if parent.name == "universe" else str(parent.name)
