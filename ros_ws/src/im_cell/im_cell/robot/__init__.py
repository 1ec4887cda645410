"""The cell's geometry and dynamics from one parameter file: joints, links, URDF, capsules, cameras.

``load_cell()`` gives a :class:`Cell`; ``urdf(cell)`` the same as URDF, ``robot_description(cell, limits)`` that of
``/robot_description``. The 18 joints are, in this order, ``left_track``, ``left_rotation``, ``left_tilt``, ``left_j1``
to ``left_j6``, then the same of ``right``.
World frame ``world``: origin on the floor at the track's centre, x along the track, z up. :mod:`im_cell.robot.truth`,
what the simulated cell is really like, is not part of the public face: only who simulates or judges imports it.
"""

from im_cell.robot.cell import SIDES, Cell, load_cell
from im_cell.robot.objects import FreeBody
from im_cell.robot.parameters import Box, Camera, Capsule, Gripper, Intrinsics, Led, Limits, SensorSpec, Vector
from im_cell.robot.scenery import Lamp, LaserScanner, Mirror, Target
from im_cell.robot.tree import ORIGIN, Joint, LinkInertia, far_end
from im_cell.robot.urdf import PALM_KGM2, robot_description, urdf

__all__ = [
    "ORIGIN",
    "PALM_KGM2",
    "SIDES",
    "Box",
    "Camera",
    "Capsule",
    "Cell",
    "FreeBody",
    "Gripper",
    "Intrinsics",
    "Joint",
    "Lamp",
    "LaserScanner",
    "Led",
    "Limits",
    "LinkInertia",
    "Mirror",
    "SensorSpec",
    "Target",
    "Vector",
    "far_end",
    "load_cell",
    "robot_description",
    "urdf",
]
