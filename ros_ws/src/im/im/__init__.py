"""Client of the machine: ``from im import Machine``; knows interfaces and rclpy alone."""

from im.calibration import CalibratedCamera, Calibration
from im.commands import Command, Progress
from im.errors import CommandCancelledError, CommandFailedError, MachineError, UnreachableError
from im.firings import Firings
from im.geometry import Pose
from im.groups import Arm, Gripper, Group
from im.machine import Machine
from im.vision import Camera, Picture, Position, Spot

__all__ = [
    "Arm",
    "CalibratedCamera",
    "Calibration",
    "Camera",
    "Command",
    "CommandCancelledError",
    "CommandFailedError",
    "Firings",
    "Gripper",
    "Group",
    "Machine",
    "MachineError",
    "Picture",
    "Pose",
    "Position",
    "Progress",
    "Spot",
    "UnreachableError",
]
