"""Node ``/mcs``: motion control of all joints; its servo runs in a process of its own."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from im_core.robot import load_cell
from im_core.ros import run as ros_run
from im_core.ros.node import ManagedNode
from im_mcs.client.groups import all_groups, group_in_force
from im_mcs.client.kinematics import Kinematics
from im_mcs.client.servo_client import OnProgress, Reply, ServoClient
from im_mcs.config import Group, McsConfig, load_config
from im_mcs.model import Model
from im_mcs.ros import messages
from im_mcs.ros.command_topics import CommandTopics
from im_mcs.ros.evidence import with_evidence
from im_mcs.ros.gripper_server import GripperServer
from im_mcs.ros.kinematics_services import KinematicsServices
from im_mcs.ros.layers import Layers
from im_mcs.ros.lifecycle import Lifecycle
from im_mcs.ros.motion_services import MotionServices
from im_mcs.ros.motions import Motions
from im_mcs.ros.move_server import MoveServer
from im_mcs.ros.publishers import Publishers
from im_mcs.ros.refusals import Refusals
from im_mcs.ros.servo_keeper import POLL_S, ServoKeeper
from im_mcs.ros.state_services import StateServices
from im_mcs.ros.trajectory_server import TrajectoryServer
from im_mcs.state import Event, State, next_state

Started = Callable[[int], None]
_STATE_PERIOD_S = 0.5
_DIAGNOSTICS_PERIOD_S = 1.0
_LIFECYCLE = {Event.POWER_ON: "activate", Event.POWER_OFF: "deactivate"}


class McsNode(ManagedNode):
    """ROS shell of the Motion Control System: translates messages, decides nothing.

    Parameters: ``config`` (a file; empty: the package's), ``preset`` (empty: the configuration's), ``period`` of the
    servo [s] (0: the configuration's).

    Attributes:
        config: Configuration, with the preset in force.
        motions: What moves groups.
        refusals: Messages on topics that were refused: nobody waits there for an answer.
    """

    def __init__(self) -> None:
        super().__init__("mcs")
        path = str(self.declare_parameter("config", "").value)
        preset = str(self.declare_parameter("preset", "").value)
        period = float(self.declare_parameter("period", 0.0).value)
        config_file = Path(path) if path else None
        self.config: McsConfig = load_config(config_file)
        if preset:
            self.config = self.config.with_preset(preset)
        if period != 0.0:
            self.config = self.config.at_period(period)
        self.cell = load_cell()
        self.model = Model(self.cell)
        self.kinematics = Kinematics(self.config, Model(self.cell))
        self.refusals = Refusals(self.get_logger())
        self._last: dict[str, Any] | None = None
        self._fresh = False
        self._keeper = ServoKeeper(self, config_file, self._publish_state)
        self.lifecycle = Lifecycle(
            self,
            {
                "configure": self._configure,
                "cleanup": self._cleanup,
                "activate": lambda: self._power(Event.POWER_ON),
                "deactivate": lambda: self._power(Event.POWER_OFF),
                "shutdown": self._shutdown,
            },
        )
        self._topics = Publishers(self, Model(self.cell))
        self._layers = Layers(self)
        self.motions = Motions(self)
        self._grippers = GripperServer(self)
        self._servers = (
            StateServices(self),
            MotionServices(self),
            KinematicsServices(self),
            MoveServer(self),
            TrajectoryServer(self),
            CommandTopics(self),
        )
        self._publish_state()

    def phase_configure(self) -> None:
        """Start the servo process and wait until it holds the testbed: lifecycle *inactive*, MCS cold."""
        self._keeper.start_blocking()
        self.lifecycle.follow("configure")
        self._publish_state()

    def phase_start(self) -> None:
        """Publish what the servo reports."""
        self.create_timer(POLL_S, self._poll, clock=self.steady_clock)
        self.create_timer(_STATE_PERIOD_S, self._publish_state, clock=self.steady_clock)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """End the servo process; the testbed brakes by itself."""
        self._keeper.close()

    @property
    def state(self) -> State:
        """Present state of MCS."""
        return self._keeper.state

    @property
    def group_names(self) -> list[str]:
        """Groups of all presets; each has its servers and topics whatever preset is in force."""
        return all_groups(self.config)

    def client(self) -> ServoClient:
        """The way to the servo.

        Raises:
            StateError: MCS is unconfigured.
        """
        return self._keeper.client()

    def group(self, name: str) -> Group:
        """A group of the preset in force.

        Raises:
            StateError: MCS is unconfigured, or the group is one of another preset.
            NotFoundError: No preset has such a group.
        """
        self.client()
        return group_in_force(self.config, name)

    def index(self, group: Group) -> np.ndarray:
        """Ranks of a group's joints among all, shape (n,)."""
        return np.array([self.model.index(joint) for joint in group.joints], dtype=np.intp)

    async def request(
        self,
        event: Event,
        arguments: dict[str, Any] | None = None,
        started: Started | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, Any]:
        """Ask the servo and await its answer.

        Args:
            event: What is asked for.
            arguments: What the event needs.
            started: Told the number of the request.
            on_progress: Told how far it is, in another thread.

        Raises:
            ImError: The servo refuses, or what was asked for ended badly; where there is a record of the last two
                seconds, the message names its file.
        """
        promise = self.promise()
        client = self.client()
        number = client.send(event, arguments, promise.set_result, on_progress)
        if started is not None:
            started(number)
        reply: Reply = await promise
        self._keeper.follow()
        self._publish_state()
        if reply.error is not None:
            raise await with_evidence(self, client, reply)
        return reply.results

    async def transition(self, event: Event) -> None:
        """Go through a transition of the state table, together with the lifecycle.

        Raises:
            ImError: It is refused, or ended badly.
        """
        self.client()
        if event in _LIFECYCLE:
            next_state(self.state, event)
            await self.lifecycle.change(_LIFECYCLE[event])
            self._keeper.follow()
        elif event in (Event.ESTOP, Event.PROTECTIVE_STOP):
            await self.request(event, {"reason": f"request on /mcs/{event.value}"})
        else:
            await self.request(event)

    async def repartition(self, preset: str) -> None:
        """Divide the joints into groups anew.

        Raises:
            ImError: There is no such preset, or the state does not allow it.
        """
        config = self.config.with_preset(preset)
        await self.request(Event.REPARTITION, {"preset": preset})
        self.config = config
        self.kinematics = Kinematics(config, Model(self.cell))
        self._publish_state()

    async def _power(self, event: Event) -> None:
        await self.request(event)

    async def _configure(self) -> None:
        next_state(self.state, Event.CONFIGURE)
        await self._keeper.start()
        self._publish_state()

    async def _cleanup(self) -> None:
        next_state(self.state, Event.CLEANUP)
        self._keeper.close()

    async def _shutdown(self) -> None:
        self._keeper.close()

    def _poll(self) -> None:
        self._keeper.poll()
        if self._keeper.running:
            client = self.client()
            self._show(client.samples())
            self._grippers.publish_feedback(client.snapshot())

    def _show(self, samples: list[dict[str, Any]]) -> None:
        if samples:
            self._last, self._fresh = samples[-1], True
            self._topics.joints(samples)
            self._layers.publish(samples, lambda: messages.laws(self.client().snapshot()))

    def _publish_state(self) -> None:
        snapshot = self.client().snapshot() if self._keeper.running else None
        self._topics.state(self.config, self.state, self._keeper.reason, snapshot)

    def _publish_diagnostics(self) -> None:
        if self._keeper.running:
            client = self.client()
            self._topics.diagnostics(self.state, client.snapshot(), client.silence_s(), self.refusals)
            if self._last is not None and not self._fresh:  # testbed time may stand still: once more, for latecomers
                self._show([self._last])
            self._fresh = False


def main() -> int:
    """Run the node."""
    return ros_run.main(McsNode)


if __name__ == "__main__":
    sys.exit(main())
