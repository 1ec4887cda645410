"""The slots: a hardware-independent view of the channels (paper, section 4)."""

from collections.abc import Sequence

import numpy as np

from im_core.errors import ConfigError
from im_mcs.testbed.driver import ChannelDriver, Drive, Measured


class TestbedInterface:
    """Joints in the order of the slots, whatever the order of the channels.

    Args:
        driver: The channels.
        channels: Channel of each joint slot.
        gripper_channels: Channel of each gripper slot.

    Raises:
        ConfigError: A channel does not exist or serves two slots.
    """

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __init__(self, driver: ChannelDriver, channels: Sequence[int], gripper_channels: Sequence[int]) -> None:
        _check(channels, driver.n_joints, "joint")
        _check(gripper_channels, driver.n_grippers, "gripper")
        self.driver = driver
        self._joints = np.array(channels, dtype=np.intp)
        self._grippers = np.array(gripper_channels, dtype=np.intp)

    def read(self) -> Measured:
        """The newest measured state, in the order of the slots."""
        m = self.driver.read()
        return Measured(
            m.tick, m.stamp_ns, m.q[self._joints], m.power, m.brakes[self._joints], m.gripper[self._grippers]
        )

    def write(self, drive: Drive) -> None:
        """Answer the tick; channels without a slot get no torque and keep their brakes."""
        tau = np.zeros(self.driver.n_joints)
        brakes = np.ones(self.driver.n_joints, dtype=np.bool_)
        gripper = np.zeros(self.driver.n_grippers)
        tau[self._joints] = drive.tau
        brakes[self._joints] = drive.brakes
        gripper[self._grippers] = drive.gripper
        self.driver.write(Drive(tau, drive.power, brakes, gripper, drive.wants_time))


def _check(channels: Sequence[int], count: int, kind: str) -> None:
    for channel in channels:
        if not 0 <= channel < count:
            raise ConfigError(f"{kind} channel {channel} does not exist; the driver has 0 to {count - 1}")
        if list(channels).count(channel) > 1:
            raise ConfigError(
                f"{kind} channel {channel} serves {list(channels).count(channel)} slots; it can serve one"
            )
