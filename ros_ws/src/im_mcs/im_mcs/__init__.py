"""Motion Control System (paper, section 4), a folder a layer.

From the bottom:

- :mod:`im_mcs.limits`: limits and configuration, what everything keeps to;
- :mod:`im_mcs.protocol`: what the servo process and the node share: requests, channel, samples, evidence;
- :mod:`im_mcs.testbed`: testbed interface layer, slots and channel drivers;
- :mod:`im_mcs.model`, :mod:`im_mcs.inverse`: kinematics and dynamics, inverse kinematics of an arm;
- :mod:`im_mcs.planning`: motion planning layer, requests to setpoints;
- :mod:`im_mcs.control`: motion control layer, setpoints to torques;
- :mod:`im_mcs.collision`, :mod:`im_mcs.safety`, :mod:`im_mcs.state`: beside the layers: distances, watches, and the
  state manager, which spans them;
- :mod:`im_mcs.servo`: the loop that runs them all, in a process of its own;
- :mod:`im_mcs.client`: client interface layer, what may be asked for;
- :mod:`im_mcs.poses`: where calibration poses are sought;
- :mod:`im_mcs.ros`: the ROS shell.

Here is what those may rely on who write a control law, a channel driver or a watch. This is not a safety-rated system.
"""

from im_mcs.control import ControlInput, Controller, ControllerSetup
from im_mcs.limits.configuration import McsConfig, load_config
from im_mcs.model import CellModel
from im_mcs.planning import Setpoint
from im_mcs.safety import Reaction, SafetyFinding, Situation, Watch
from im_mcs.state import Event, State
from im_mcs.testbed import ChannelDriver, Drive, Measured

__all__ = [
    "CellModel",
    "ChannelDriver",
    "ControlInput",
    "Controller",
    "ControllerSetup",
    "Drive",
    "Event",
    "McsConfig",
    "Measured",
    "Reaction",
    "SafetyFinding",
    "Setpoint",
    "Situation",
    "State",
    "Watch",
    "load_config",
]
