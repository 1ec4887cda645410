"""Motion planning layer (paper, section 4): requests of the client layer to setpoints for the control layer.

| to learn | open |
|---|---|
| how the setpoints of a group come about | :mod:`.planner` |
| which kinds of motion there are | :mod:`.motions`, :mod:`.line` |
| what a trajectory is, and how it is followed, slowed down and stopped | :mod:`.trajectories` |
| whether it keeps to the limits; what becomes of one that does not | :mod:`.checks`, :mod:`.retiming` |
"""

from im_mcs.limits.motion_limits import MotionLimits, Synchrony
from im_mcs.planning.motions.joint import JointPath
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory

__all__ = ["JointPath", "MotionLimits", "PiecewisePolynomial", "Setpoint", "Synchrony", "Trajectory"]
