"""The cell's geometry and dynamics from a URDF and a cell file: joints, links, capsules, cameras.

``load_cell()`` gives a :class:`Cell`; ``urdf(cell)`` the same as URDF, ``robot_description(cell, limits)`` that of
``/robot_description``. Joints are in the order of the URDF's tree, those below one link by name.
World frame ``world``: z up; ``mount`` of the cell file says where in it the URDF's root stands.
:mod:`im_cell.robot.truth`, what the simulated cell is really like, is not part of the public face: only who simulates
or judges imports it.
"""

from im_cell.robot.arm_errors import kinematic_derivatives
from im_cell.robot.cell import Cell, cell_file, load_cell, shipped_cells
from im_cell.robot.objects import FreeBody
from im_cell.robot.parameters import (
    Box,
    Camera,
    Capsule,
    Gripper,
    Group,
    Hull,
    Intrinsics,
    Led,
    Limits,
    SensorSpec,
    Vector,
)
from im_cell.robot.scenery import Lamp, LaserScanner, Mirror, Target
from im_cell.robot.tree import ORIGIN, Joint, LinkInertia
from im_cell.robot.urdf import PALM_KGM2, robot_description, scenery_urdf, urdf

__all__ = [
    "ORIGIN",
    "PALM_KGM2",
    "Box",
    "Camera",
    "Capsule",
    "Cell",
    "FreeBody",
    "Gripper",
    "Group",
    "Hull",
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
    "cell_file",
    "kinematic_derivatives",
    "load_cell",
    "robot_description",
    "scenery_urdf",
    "shipped_cells",
    "urdf",
]
