"""Inverse kinematics: joint positions for poses of a wrist, redundancy resolved."""

from im_mcs.inverse.arm import Arm
from im_mcs.inverse.solver import IkAttempt, InverseKinematics
from im_mcs.inverse.tracking import ArmTracker, Tracked

__all__ = ["Arm", "ArmTracker", "IkAttempt", "InverseKinematics", "Tracked"]
