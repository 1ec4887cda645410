"""Node ``/mcs``."""

import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from im_core import clock
from im_core.errors import ImError, LinkError, StateError
from im_core.robot import load_cell
from im_core.ros import run as ros_run
from im_core.ros.coroutines import Promise
from im_core.ros.node import ManagedNode
from im_mcs.client.kinematics import Kinematics
from im_mcs.client.servo_client import OnProgress, Reply, ServoClient
from im_mcs.config import McsConfig, load_config
from im_mcs.model import Model
from im_mcs.ros.kinematics_services import KinematicsServices
from im_mcs.ros.lifecycle import Lifecycle
from im_mcs.ros.motion_server import MotionServer
from im_mcs.ros.publishers import Publishers
from im_mcs.ros.servo_owner import ServoOwner
from im_mcs.ros.state_services import StateServices
from im_mcs.state import UNCONFIGURED_MESSAGE, Event, State, lifecycle_of, next_state

Started = Callable[[int], None]
_POLL_S = 0.02
_STATE_PERIOD_S = 0.5
_DIAGNOSTICS_PERIOD_S = 1.0
_LIFECYCLE = {Event.POWER_ON: "activate", Event.POWER_OFF: "deactivate"}


class McsNode(ManagedNode):
    """ROS shell of the Motion Control System: translates messages, decides nothing.

    Parameters: ``config`` (a file; empty: the package's), ``preset`` (empty: the configuration's).
    """

    def __init__(self) -> None:
        super().__init__("mcs")
        path = str(self.declare_parameter("config", "").value)
        preset = str(self.declare_parameter("preset", "").value)
        self._config_file = Path(path) if path else None
        self.config: McsConfig = load_config(self._config_file)
        if preset:
            self.config = self.config.with_preset(preset)
        cell = load_cell()
        self.model = Model(cell)
        self.kinematics = Kinematics(self.config, Model(cell))
        self._owner: ServoOwner | None = None
        self._starting: tuple[ServoOwner, Promise] | None = None
        self._reason = ""
        self._changes: deque[tuple[State, str]] = deque()
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
        self._topics = Publishers(self, self.config, Model(cell))
        self._servers = (StateServices(self), KinematicsServices(self), MotionServer(self))
        self._publish_state()

    def phase_configure(self) -> None:
        """Start the servo process and wait until it holds the testbed: lifecycle *inactive*, MCS cold."""
        owner = self._start_servo()
        try:
            while not owner.ready():
                clock.sleep(_POLL_S)
        except ImError:
            owner.close()
            raise
        self._owner = owner
        self.lifecycle.follow("configure")
        self._publish_state()

    def phase_start(self) -> None:
        """Publish what the servo reports."""
        self.create_timer(_POLL_S, self._poll, clock=self.steady_clock)
        self.create_timer(_STATE_PERIOD_S, self._publish_state, clock=self.steady_clock)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """End the servo process; the testbed brakes by itself."""
        self._close_servo()

    @property
    def state(self) -> State:
        """Present state of MCS."""
        return State.UNCONFIGURED if self._owner is None else self._owner.client.state()

    def client(self) -> ServoClient:
        """The way to the servo.

        Raises:
            StateError: MCS is unconfigured.
        """
        if self._owner is None:
            reason = f" ({self._reason})" if self._reason else ""
            raise StateError(UNCONFIGURED_MESSAGE + reason, state=State.UNCONFIGURED.value)
        return self._owner.client

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
            ImError: The servo refuses, or what was asked for ended badly.
        """
        promise = self.promise()
        number = self.client().send(event, arguments, promise.set_result, on_progress)
        if started is not None:
            started(number)
        reply: Reply = await promise
        self._follow_servo()
        if reply.error is not None:
            raise reply.error
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
            self._follow_servo()
        else:
            await self.request(event, {"reason": "request on /mcs/estop"} if event is Event.ESTOP else None)

    async def _power(self, event: Event) -> None:
        await self.request(event)

    async def _configure(self) -> None:
        next_state(self.state, Event.CONFIGURE)
        owner = self._start_servo()
        self._starting = owner, self.promise()
        try:
            await self._starting[1]
        except ImError:
            owner.close()
            raise
        finally:
            self._starting = None
        self._owner = owner
        self._publish_state()

    async def _cleanup(self) -> None:
        next_state(self.state, Event.CLEANUP)
        self._close_servo()

    async def _shutdown(self) -> None:
        self._close_servo()

    def _start_servo(self) -> ServoOwner:
        self._reason = ""
        return ServoOwner(self.config, self._config_file, self._take_state)

    def _close_servo(self) -> None:
        owner, self._owner = self._owner, None
        if owner is not None:
            owner.close()

    def _take_state(self, state: State, reason: str) -> None:
        """A change of state, told by the thread that listens to the servo."""
        self._changes.append((state, reason))
        self.wake()

    def _poll(self) -> None:
        self._follow_servo()
        self._await_servo()
        owner = self._owner
        if owner is None:
            return
        try:
            owner.process.check()
        except LinkError as error:
            self._reason = error.message
            self.get_logger().error(error.message)
            owner.client.give_up(error)
            self._close_servo()
            self._follow_servo()
            self._publish_state()
            return
        self._topics.joints(owner.client.samples())

    def _await_servo(self) -> None:
        if self._starting is None or self._starting[1].done():
            return
        owner, promise = self._starting
        try:
            if owner.ready():
                promise.set_result(None)
        except LinkError as error:
            promise.set_exception(error)

    def _follow_servo(self) -> None:
        """Let the lifecycle and ``/mcs/state`` follow what has happened in the servo."""
        wanted, present = lifecycle_of(self.state), self.lifecycle.state
        if present == "active" and wanted != "active":
            self.lifecycle.follow("deactivate")
        if self.lifecycle.state == "inactive" and wanted == "unconfigured":
            self.lifecycle.follow("cleanup")
        while self._changes:
            state, self._reason = self._changes.popleft()
            text = f"MCS is {state.value}" + (f": {self._reason}" if self._reason else "")
            self.get_logger().warning(text) if state is State.ESTOPPED else self.get_logger().info(text)
            self._publish_state()

    def _publish_state(self) -> None:
        snapshot = None if self._owner is None else self._owner.client.snapshot()
        self._topics.state(self.state, self._reason, snapshot)

    def _publish_diagnostics(self) -> None:
        if self._owner is not None:
            self._topics.diagnostics(self.state, self._owner.client.snapshot())
            self._topics.repeat()


def main() -> int:
    """Run the node."""
    return ros_run.main(McsNode)


if __name__ == "__main__":
    sys.exit(main())
