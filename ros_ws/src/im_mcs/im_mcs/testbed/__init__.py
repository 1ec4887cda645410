"""Testbed interface layer (paper, section 4): channel drivers behind one contract, a slot for each joint and sensor."""

from im_mcs.testbed.driver import ChannelDriver, Drive, Measured, PlannedCourse, load_driver
from im_mcs.testbed.slots import TestbedInterface

__all__ = ["ChannelDriver", "Drive", "Measured", "PlannedCourse", "TestbedInterface", "load_driver"]
