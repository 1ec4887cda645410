"""The node's hold on the servo process: start it, watch it, end it."""

from pathlib import Path

from im_core import clock, names
from im_core.errors import LinkError, StateError
from im_core.ros.subprocess import ChildProcess
from im_core.testbed_link import TestbedLink
from im_mcs.client.servo_client import OnState, ServoClient
from im_mcs.client.time_source import FlowingTime, TestbedTime
from im_mcs.config import McsConfig
from im_mcs.servo.channel import ServoChannel
from im_mcs.testbed.driver import asks_for_time


class ServoOwner:
    """A running servo process and the way to talk to it.

    Must be made in a thread that lives as long as the node: the process dies with the thread that started it.

    Args:
        config: Configuration.
        config_file: Where it came from; None: the one of the package.
        on_state: Told of every change of state, in another thread.
    """

    def __init__(self, config: McsConfig, config_file: Path | None, on_state: OnState) -> None:
        instance = names.instance()
        self._on_state = on_state
        self._timeout_s = 2.0 * config.testbed.attach_timeout_s
        self._on_demand = asks_for_time(config.testbed.drivers[config.testbed.clock].driver)
        self._deadline = clock.monotonic() + self._timeout_s
        self._channel = ServoChannel.create(instance, config)
        arguments = [instance, str(config_file or ""), config.preset, repr(config.servo.period_s)]
        self.process = ChildProcess("im_mcs.servo", arguments, names.run_dir() / "servo.log")
        self._client: ServoClient | None = None

    @property
    def client(self) -> ServoClient:
        """The way to talk to the servo, once it is ready."""
        if self._client is None:
            raise StateError("the servo process is not ready yet")
        return self._client

    def ready(self) -> bool:
        """Whether the servo runs and holds the testbed; to be asked until it does.

        Raises:
            LinkError: It ended, or was not ready in time; the message says why.
        """
        if self._client is not None:
            return True
        if self._channel.snapshot.sequence == 0:
            self.process.check()
            if clock.monotonic() > self._deadline:
                raise LinkError(f"the servo process was not ready within {self._timeout_s:g} s")
            return False
        time = TestbedTime(TestbedLink.attach(names.instance(), 1.0)) if self._on_demand else FlowingTime()
        self._client = ServoClient(self._channel, time, self._on_state)
        return True

    def close(self) -> None:
        """End the process; the testbed brakes. Nothing is left behind."""
        if self._client is not None:
            self._client.close()
        self.process.terminate()
        self._channel.close()
