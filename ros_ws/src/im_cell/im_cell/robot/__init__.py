"""The cell's geometry and dynamics from one parameter file: joints, links, URDF, capsules, cameras.

``load_cell()`` gives a :class:`~im_core.robot.parameters.Cell`; ``urdf(cell)`` the same as URDF. The 18 joints are, in
this order, ``left_track``, ``left_rotation``, ``left_tilt``, ``left_j1`` to ``left_j6``, then the same of ``right``.
World frame ``world``: origin on the floor at the track's centre, x along the track, z up.
"""

from im_core.robot.cell import Cell, load_cell
from im_core.robot.parameters import Box, Camera, Capsule, Gripper, Intrinsics, Led, Limits, SensorSpec
from im_core.robot.tree import Joint, Link
from im_core.robot.urdf import urdf

__all__ = [
    "Box",
    "Camera",
    "Capsule",
    "Cell",
    "Gripper",
    "Intrinsics",
    "Joint",
    "Led",
    "Limits",
    "Link",
    "SensorSpec",
    "load_cell",
    "urdf",
]
