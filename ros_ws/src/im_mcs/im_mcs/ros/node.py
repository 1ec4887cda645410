"""Node ``/mcs``: motion control of all joints; the servo runs in a separate process."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from im_core import clock
from im_core.rate_groups import RateStatistics
from im_core.ros import run as ros_run
from im_core.ros.messages.rates import rate_status
from im_core.ros.node import ManagedNode
from im_mcs.limits.configuration import load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions.gripper_server import GripperServer
from im_mcs.ros.actions.motions import Motions
from im_mcs.ros.actions.move_server import MoveServer
from im_mcs.ros.actions.trajectory_server import TrajectoryServer
from im_mcs.ros.controller_services import ControllerServices
from im_mcs.ros.estop_server import EstopServer
from im_mcs.ros.services import KinematicsServices, MotionServices, StateServices, SurroundingsServices, offer
from im_mcs.ros.servo_keeper import POLL_S
from im_mcs.ros.topics.command_topics import CommandTopics
from im_mcs.ros.topics.controller_state import ControllerStates
from im_mcs.ros.topics.layers import Layers
from im_mcs.ros.topics.path_markers import PathMarkers
from im_mcs.ros.topics.publishers import Publishers

_STATE_PERIOD_S = 0.5
_LONGEST_UNTOLD_S = 5.0
_DIAGNOSTICS_PERIOD_S = 1.0


class McsNode(ManagedNode):
    """ROS shell of the Motion Control System: translates messages, decides nothing."""

    def __init__(self) -> None:
        super().__init__("mcs")
        declare = self.declared.declare
        path = declare("config", "", "file of slots, groups, limits and laws; empty: the package's mcs.yaml")
        preset = declare("preset", "", "division of the joints at the start, by its name; empty: the configuration's")
        period = declare("period", 0.0, "of the servo [s]; 0: the configuration's", span=(0.0, 0.1))
        rate = declare(
            "joint_state_rate",
            0.0,
            "of /joint_states, /tf and the layers, by testbed time [1/s]; never more than one a tick; 0: the "
            "configuration's",
            span=(0.0, 250.0),
        )
        config_file = Path(path) if path else None
        config = load_config(config_file)
        if preset:
            config = config.with_preset(preset)
        if period != 0.0:
            config = config.at_period(period)
        if rate != 0.0:
            config = config.at_sample_rate(rate)
        self._last: dict[str, Any] | None = None
        self._fresh, self._state_told = False, 0.0
        self._protective_stops: dict[str, str] = {}
        self._rates: tuple[RateStatistics, ...] = ()
        self._mcs = McsAccess(self, config, config_file, self._publish_state)
        cell = self._mcs.cell
        self._topics = Publishers(self, cell, config, JointLimits(cell, config.limits, config.slots))
        self._layers = Layers(self._mcs)
        self._controllers = ControllerStates(self._mcs)
        self._markers = PathMarkers(self._mcs)
        motions = Motions(self._mcs, self._markers)
        self._grippers = GripperServer(self._mcs)
        states = StateServices(self._mcs)
        self._servers = (
            states,
            ControllerServices(self._mcs, states),
            MotionServices(self._mcs),
            KinematicsServices(self._mcs),
            SurroundingsServices(self._mcs),
            MoveServer(self._mcs, motions),
            TrajectoryServer(self._mcs, motions),
        )
        for wrist in self._layers.wrists:
            offer(self._mcs, Trigger, f"/{wrist}/tare", partial(self._layers.tare, wrist))
        self._commands = CommandTopics(self._mcs)
        self._estop = EstopServer(self._mcs)
        self._publish_state()

    def phase_configure(self) -> None:
        """Start the servo and wait until the servo holds the testbed: lifecycle *inactive*, MCS cold."""
        self._mcs.keeper.start_blocking(self._mcs.config)
        self._mcs.lifecycle.follow("configure")
        self._publish_state()

    def phase_start(self) -> None:
        """Publish the reports of the servo."""
        period_s = min(POLL_S, 1.0 / self._mcs.config.servo.sample_rate_hz)
        self.create_timer(period_s, self._look_after, clock=self.steady_clock)
        self.create_timer(_STATE_PERIOD_S, self._publish_state, clock=self.steady_clock)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """End the servo process; the testbed brakes without a servo."""
        self._mcs.keeper.close()
        self._estop.close()

    def destroy_node(self) -> None:
        """Leave the graph, which the state machine of rcl would keep the node in."""
        self._mcs.lifecycle.destroy()
        destroy: Callable[[], None] = super().destroy_node  # rclpy says no types
        destroy()

    def _look_after(self) -> None:
        self._mcs.keeper.poll()
        self._markers.publish()
        if self._mcs.keeper.running:
            client = self._mcs.client()
            self._show(client.samples())
            self._grippers.publish_feedback(client.snapshot())
            self._commands.publish_status(client.snapshot())

    def _show(self, samples: list[dict[str, Any]]) -> None:
        if samples:
            self._last, self._fresh = samples[-1], True
            self._topics.joints(samples)
            self._layers.publish(samples, lambda: messages.laws(self._mcs.client().snapshot()))
            self._controllers.publish(samples, lambda: messages.speeds(self._mcs.client().snapshot()))

    def _publish_state(self) -> None:
        snapshot = self._mcs.client().snapshot() if self._mcs.keeper.running else None
        keeper, now = self._mcs.keeper, clock.monotonic()
        if not keeper.explained and now < self._state_told + _LONGEST_UNTOLD_S:
            return  # the cause of the state is on the way, and published with it
        self._state_told = now
        state = messages.mcs_state(self._mcs.config, self._mcs.state, keeper.reason, snapshot, keeper.read_past)
        self._topics.state(state)
        self._log_protective_stops({group.group: group.protective_stop for group in state.groups})

    def _log_protective_stops(self, causes: dict[str, str]) -> None:
        for group, cause in causes.items():
            if cause and cause != self._protective_stops.get(group):
                self.get_logger().warning(f"group '{group}' decelerates and holds: {cause}")
        self._protective_stops = causes

    def _publish_diagnostics(self) -> None:
        mcs = self._mcs
        stamp_ns, servo = self._servo_status()
        lifecycle = messages.lifecycle_status(mcs.lifecycle.state, mcs.lifecycle.failure)
        refused = messages.refusals_status(mcs.refusals.counts())
        taken_over = messages.take_overs_status(mcs.take_overs.newest())
        self._topics.diagnostics(stamp_ns, (servo, lifecycle, refused, taken_over))
        if mcs.keeper.running:
            self._publish_rates(stamp_ns)
            if self._last is not None and not self._fresh:  # testbed time may stand still: once more, for latecomers
                self._show([self._last])
            self._fresh = False

    def _publish_rates(self, stamp_ns: int) -> None:
        rates = self._mcs.client().rates
        if rates != self._rates:
            told = {each.name: each.ended for each in self._rates}
            for each in rates:
                if each.ended and each.ended != told.get(each.name):
                    self.get_logger().error(f"function '{each.name}' of the servo is called no more: {each.ended}")
            self._rates = rates
            self._topics.rates(stamp_ns, [rate_status("mcs", each) for each in rates])

    def _servo_status(self) -> tuple[int, DiagnosticStatus]:
        """When [ns], and how the servo is."""
        mcs = self._mcs
        if not mcs.keeper.running:
            return self.get_clock().now().nanoseconds, messages.servo_missing(mcs.state, mcs.keeper.reason)
        client = mcs.client()
        snapshot = client.snapshot()
        return int(snapshot["stamp_ns"]), messages.servo_status(mcs.state, snapshot, client.silence_s())


def main() -> int:
    """Run the node."""
    return ros_run.main(McsNode)


if __name__ == "__main__":
    sys.exit(main())
