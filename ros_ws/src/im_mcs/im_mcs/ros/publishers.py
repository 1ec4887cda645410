"""Everything that ``/mcs`` publishes."""

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from im_core.robot import urdf
from im_core.ros import qos
from im_mcs.config import McsConfig
from im_mcs.model import Model
from im_mcs.ros import messages
from im_mcs.ros.frames import Frames
from im_mcs.ros.refusals import Refusals
from im_mcs.state import State
from im_msgs.msg import McsState


class Publishers:
    """Topics of MCS; ``/robot_description`` and ``/tf_static`` are published at once and latched.

    Args:
        node: The node that publishes.
        model: Kinematics; used by this object alone.
    """

    def __init__(self, node: Node, model: Model) -> None:
        self._names = model.names
        self._frames = Frames(model.cell, model)
        self._state = node.create_publisher(McsState, "/mcs/state", qos.LATCHED)
        self._joints = node.create_publisher(JointState, "/joint_states", qos.EVENTS)
        self._tf = node.create_publisher(TFMessage, "/tf", qos.EVENTS)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", qos.EVENTS)
        self._tf_static = node.create_publisher(TFMessage, "/tf_static", qos.LATCHED)
        self._tf_static.publish(TFMessage(transforms=self._frames.fixed()))
        self._description = node.create_publisher(String, "/robot_description", qos.LATCHED)
        self._description.publish(String(data=urdf(model.cell)))

    def state(self, config: McsConfig, state: State, reason: str, snapshot: NDArray[np.void] | None) -> None:
        """``/mcs/state``."""
        self._state.publish(messages.mcs_state(config, state, reason, snapshot))

    def joints(self, samples: list[dict[str, Any]]) -> None:
        """``/joint_states`` of every sample of the servo, ``/tf`` of the last."""
        for sample in samples:
            self._joints.publish(messages.joint_state(self._names, sample))
        if samples:
            last = samples[-1]
            self._tf.publish(TFMessage(transforms=self._frames.moving(np.array(last["q"]), last["stamp_ns"])))

    def diagnostics(self, state: State, snapshot: NDArray[np.void], silence_s: float, refusals: Refusals) -> None:
        """``/diagnostics``; ``silence_s``: since the servo's last sign of life [s]."""
        self._diagnostics.publish(messages.diagnostics(state, snapshot, silence_s, refusals.counts()))
