"""Motion planning layer (paper, section 4): requests of the client layer to setpoints for the control layer."""

from im_mcs.limits.motion_limits import MotionLimits, Synchrony
from im_mcs.planning.joint import JointPath
from im_mcs.planning.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectory import Setpoint, Trajectory

__all__ = ["JointPath", "MotionLimits", "PiecewisePolynomial", "Setpoint", "Synchrony", "Trajectory"]
