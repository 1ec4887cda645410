import numpy as np
import pytest

from im_core.errors import ConfigError
from im_mcs.testbed import Drive, TestbedInterface, load_driver
from im_mcs.testbed.loopback import LoopbackDriver


@pytest.fixture
def driver():
    return LoopbackDriver(np.ones(4), np.array([0.0, 0.1, 0.2, 0.3]))


def test_slots_are_independent_of_channels(driver):
    testbed = TestbedInterface(driver, [2, 0, 1], [1, 0])
    np.testing.assert_array_equal(testbed.read().q, [0.2, 0.0, 0.1])
    brakes = np.array([True, False, False])
    testbed.write(Drive(np.array([1.0, 2.0, 3.0]), True, brakes, np.array([0.01, 0.02]), True))
    np.testing.assert_array_equal(driver.drive.tau, [2.0, 3.0, 1.0, 0.0])
    np.testing.assert_array_equal(driver.drive.brakes, [False, False, True, True])
    np.testing.assert_array_equal(driver.drive.gripper, [0.02, 0.01])
    assert driver.q[0] > 0.0
    assert driver.q[2] == 0.2  # braked
    assert driver.q[3] == 0.3  # no slot


@pytest.mark.parametrize(
    ("channels", "message"), [([0, 4], "joint channel 4 does not exist"), ([1, 1], "joint channel 1 serves 2 slots")]
)
def test_channels_are_checked(driver, channels, message):
    with pytest.raises(ConfigError, match=message):
        TestbedInterface(driver, channels, [0, 1])


def test_unknown_drivers_are_named():
    with pytest.raises(ConfigError, match=r"nowhere:Driver.*module:Class"):
        load_driver("nowhere:Driver")
