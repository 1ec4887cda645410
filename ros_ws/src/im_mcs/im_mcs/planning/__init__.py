"""Motion planning layer (paper, section 4): requests of the client layer to setpoints for the control layer."""

from im_mcs.planning.joint_path import JointPath, MotionLimits
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.setpoint import Setpoint
from im_mcs.planning.stop import StopTrajectory
from im_mcs.planning.trajectory import Hold, Trajectory

__all__ = ["GroupPlanner", "Hold", "JointPath", "MotionLimits", "Setpoint", "StopTrajectory", "Trajectory"]
