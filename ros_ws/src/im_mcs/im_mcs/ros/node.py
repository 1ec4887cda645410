"""Node ``/mcs``: motion control of all joints; its servo runs in a process of its own."""

import sys
from pathlib import Path
from typing import Any

from im_core.ros import run as ros_run
from im_core.ros.node import ManagedNode
from im_mcs.limits.configuration import load_config
from im_mcs.model import CellModel
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.command_topics import CommandTopics
from im_mcs.ros.gripper_server import GripperServer
from im_mcs.ros.layers import Layers
from im_mcs.ros.motions import Motions
from im_mcs.ros.move_server import MoveServer
from im_mcs.ros.publishers import Publishers
from im_mcs.ros.services import KinematicsServices, MotionServices, StateServices
from im_mcs.ros.servo_keeper import POLL_S
from im_mcs.ros.trajectory_server import TrajectoryServer

_STATE_PERIOD_S = 0.5
_DIAGNOSTICS_PERIOD_S = 1.0


class McsNode(ManagedNode):
    """ROS shell of the Motion Control System: translates messages, decides nothing.

    Parameters: ``config`` (a file; empty: the package's), ``preset`` (empty: the configuration's), ``period`` of the
    servo [s] (0: the configuration's).
    """

    def __init__(self) -> None:
        super().__init__("mcs")
        path = str(self.declare_parameter("config", "").value)
        preset = str(self.declare_parameter("preset", "").value)
        period = float(self.declare_parameter("period", 0.0).value)
        config_file = Path(path) if path else None
        config = load_config(config_file)
        if preset:
            config = config.with_preset(preset)
        if period != 0.0:
            config = config.at_period(period)
        self._last: dict[str, Any] | None = None
        self._fresh = False
        self._mcs = McsAccess(self, config, config_file, self._publish_state)
        self._topics = Publishers(self, CellModel(self._mcs.cell))
        self._layers = Layers(self._mcs)
        motions = Motions(self._mcs)
        self._grippers = GripperServer(self._mcs)
        self._servers = (
            StateServices(self._mcs),
            MotionServices(self._mcs),
            KinematicsServices(self._mcs),
            MoveServer(self._mcs, motions),
            TrajectoryServer(self._mcs, motions),
            CommandTopics(self._mcs),
        )
        self._publish_state()

    def phase_configure(self) -> None:
        """Start the servo process and wait until it holds the testbed: lifecycle *inactive*, MCS cold."""
        self._mcs.keeper.start_blocking(self._mcs.config)
        self._mcs.lifecycle.follow("configure")
        self._publish_state()

    def phase_start(self) -> None:
        """Publish what the servo reports."""
        self.create_timer(POLL_S, self._look_after, clock=self.steady_clock)
        self.create_timer(_STATE_PERIOD_S, self._publish_state, clock=self.steady_clock)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """End the servo process; the testbed brakes by itself."""
        self._mcs.keeper.close()

    def _look_after(self) -> None:
        self._mcs.keeper.poll()
        if self._mcs.keeper.running:
            client = self._mcs.client()
            self._show(client.samples())
            self._grippers.publish_feedback(client.snapshot())

    def _show(self, samples: list[dict[str, Any]]) -> None:
        if samples:
            self._last, self._fresh = samples[-1], True
            self._topics.joints(samples)
            self._layers.publish(samples, lambda: messages.laws(self._mcs.client().snapshot()))

    def _publish_state(self) -> None:
        snapshot = self._mcs.client().snapshot() if self._mcs.keeper.running else None
        self._topics.state(self._mcs.config, self._mcs.state, self._mcs.keeper.reason, snapshot)

    def _publish_diagnostics(self) -> None:
        if self._mcs.keeper.running:
            client = self._mcs.client()
            mcs, silence_s = self._mcs, client.silence_s()
            self._topics.diagnostics(mcs.state, client.snapshot(), silence_s, mcs.refusals, mcs.take_overs)
            if self._last is not None and not self._fresh:  # testbed time may stand still: once more, for latecomers
                self._show([self._last])
            self._fresh = False


def main() -> int:
    """Run the node."""
    return ros_run.main(McsNode)


if __name__ == "__main__":
    sys.exit(main())
