import os
import re

import numpy as np
import pytest

from im_cell.link import HostEnd, Sensors
from im_core.errors import ConfigError
from im_mcs.limits.configuration import load_config
from im_mcs.limits.slots import Driver, Slot
from im_mcs.safety.stop_circuits import StopCircuits
from im_mcs.testbed import Drive, TestbedInterface, load_driver
from im_mcs.testbed.loopback import LoopbackDriver
from support.mcs_config import mcs_text

FULL = np.array([np.inf, np.inf])


def slots(joints, grippers=(), wrenches=()):
    kinds = {"joint": joints, "gripper": grippers, "wrench": wrenches}
    return [
        Slot(name=f"{kind}_{driver}_{channel}", kind=kind, driver=driver, channel=channel)
        for kind, channels in kinds.items()
        for driver, channel in channels
    ]


@pytest.fixture
def driver():
    return LoopbackDriver(np.ones(4), np.array([0.0, 0.1, 0.2, 0.3]))


def test_slots_are_independent_of_channels(driver):
    places = slots([("a", 2), ("a", 0), ("a", 1)], [("a", 1), ("a", 0)])
    testbed = TestbedInterface({"a": driver}, places, "a")
    np.testing.assert_array_equal(testbed.read().q, [0.2, 0.0, 0.1])
    brakes = np.array([True, False, False])
    testbed.write(Drive(np.array([1.0, 2.0, 3.0]), True, brakes, np.array([0.01, 0.02]), True, np.array([5.0, 6.0])))
    np.testing.assert_array_equal(driver.drive.command, [2.0, 3.0, 1.0, 0.0])
    np.testing.assert_array_equal(driver.drive.brakes, [False, False, True, True])
    np.testing.assert_array_equal(driver.drive.gripper, [0.02, 0.01])
    np.testing.assert_array_equal(driver.drive.gripper_force, [6.0, 5.0])
    assert driver.q[0] > 0.0
    assert driver.q[2] == 0.2  # braked
    assert driver.q[3] == 0.3  # no slot


def test_slots_of_several_drivers_are_one_robot(driver):
    other = LoopbackDriver([2.0, 2.0], [7.0, 8.0])
    places = slots([("b", 1), ("a", 3), ("b", 0)], [("b", 0), ("a", 1)], [("b", 1)])
    testbed = TestbedInterface({"a": driver, "b": other}, places, "b")
    assert testbed.read().q.tolist() == [8.0, 0.3, 7.0]
    free = np.zeros(3, dtype=bool)
    for _ in range(3):
        testbed.write(Drive(np.array([4.0, 5.0, 6.0]), True, free, np.array([0.03, 0.04]), True, FULL))
    measured = testbed.read()
    assert (measured.tick, measured.power) == (3, True)
    assert not measured.brakes.any()
    np.testing.assert_array_equal(measured.q, [other.q[1], driver.q[3], other.q[0]])
    assert measured.q[0] > 8.0
    assert measured.gripper.tolist() == [0.03, 0.04]
    assert (measured.age_s.shape, measured.wrench.shape) == ((3,), (1, 6))
    other.drive = Drive(np.zeros(2), False, np.ones(2, dtype=bool), np.zeros(2), False, FULL)
    assert not testbed.read().power, "power is on where every driver has it"


def test_a_channel_that_does_not_exist_is_named_with_slot_and_driver(driver):
    with pytest.raises(ConfigError, match=r"slot 'joint_a_4': joint channel 4 of driver 'a' does not exist; .* 0 to 3"):
        TestbedInterface({"a": driver}, slots([("a", 4)]), "a")
    driver.n_wrenches = 0
    with pytest.raises(ConfigError, match=r"slot 'wrench_a_0': wrench channel 0 of driver 'a' .* has none"):
        TestbedInterface({"a": driver}, slots([("a", 0)], [], [("a", 0)]), "a")


def test_drivers_share_one_period(driver):
    with pytest.raises(ConfigError, match=r"driver 'b' ticks every 0.001 s, the clock 'a' every 0.0045 s"):
        TestbedInterface({"a": driver, "b": LoopbackDriver([1.0], [0.0], period_s=0.001)}, slots([("a", 0)]), "a")


LEFT_J1 = "{name: left_j1, driver: testbed, channel: 3}"
FIRST = "driver: testbed, channel: 0}"
JAWS = "kind: gripper, driver: testbed, channel: 0}"


def limited(slot, limits):
    return f"{slot[:-1]}, limits: {limits}" + "}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("testbed.simulated:Sim", "testbed.simulated:Simm", r"yaml:\d+: testbed.drivers.testbed: .*SimmulatedDriver"),
        ("im_mcs.testbed.simulated", "im_mcs.testbad.simulated", r"No module named 'im_mcs.testbad'; .* module:Class"),
        ("SimulatedDriver}", "SimulatedDriver, settings: {speed: 2}}", "no setting 'speed'; .* takes no settings"),
        ("simulated:SimulatedDriver}", "bag:BagDriver}", "setting 'bag' is missing; .* takes bag, joints, topic"),
        ("clock: testbed", "clock: clock", "clock 'clock' is not one of the drivers testbed"),
        (LEFT_J1, LEFT_J1.replace("testbed", "robot"), r"slot 'left_j1': there is no driver 'robot' \(known: testbed"),
        (LEFT_J1, LEFT_J1.replace("3", "2"), "channel 2 of driver 'testbed' already serves slot 'left_tilt'"),
        (LEFT_J1, LEFT_J1.replace("3", "-3"), r"yaml:\d+: slots\[3\].channel: -3"),
        (LEFT_J1, limited(LEFT_J1, "{lower: 1, upper: 0}"), r"slots\[3\].limits: .*lower 1.* is not < upper 0"),
        (FIRST, limited(FIRST, "{velocity: 0}"), r"slots\[0\].limits.velocity: .*greater than 0"),
        (JAWS, limited(JAWS, "{torque: 1}"), "slot 'left_gripper' is a gripper; only joints have limits"),
    ],
)  # fmt: skip
def test_mistakes_in_the_configuration_are_named(tmp_path, old, new, message):
    text = mcs_text()
    assert old in text
    path = tmp_path / "mcs.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message):
        load_config(path)


def test_configured_drivers_are_made_with_their_settings():
    settings = {"inertia": [1.0, 2.0], "q": [0.1, 0.2], "period_s": 0.002}
    driver = load_driver(
        "im_mcs.testbed.loopback:LoopbackDriver", settings, instance="im0", timeout_s=1.0, interfaces={}
    )
    assert (driver.n_joints, driver.period_s) == (2, 0.002)
    assert driver.read().q.tolist() == [0.1, 0.2]
    with pytest.raises(ConfigError, match=r"nowhere:Driver.*module:Class"):
        load_driver("nowhere:Driver", {}, instance="im0", timeout_s=1.0, interfaces={})


def test_stop_circuits_say_what_they_could_not_do():
    """A driver without one, and one whose testbed is not there; and one that is cut."""
    names = {"robot": "im_mcs.testbed.loopback:LoopbackDriver", "testbed": "im_mcs.testbed.simulated:SimulatedDriver"}
    drivers = {name: Driver.model_construct(driver=path, settings={}) for name, path in names.items()}
    circuits = StopCircuits(drivers, f"imstop{os.getpid()}")
    assert re.fullmatch(r"that of testbed is not: .+; robot has no stop circuit", circuits.cut())
    assert not circuits.is_cut()
    with HostEnd.create(f"imstop{os.getpid()}", factor=0.0) as host:
        still = np.zeros(18)
        sensors = Sensors(still, False, still == 0.0, np.zeros(2), still, np.zeros((2, 6)), np.zeros(2))
        host.publish_state(0, sensors, still, still)
        assert circuits.cut() == "the stop circuit of testbed is cut; robot has no stop circuit"
        assert circuits.is_cut()
        circuits.restore()
        assert not circuits.is_cut()
