"""Testbed interface layer (paper, section 4): channel drivers behind one contract, a slot for each joint and sensor."""

from im_mcs.testbed.driver import ChannelDriver, PlannedCourse, Drive, Measured, load_driver
from im_mcs.testbed.slots import TestbedInterface

__all__ = ["ChannelDriver", "PlannedCourse", "Drive", "Measured", "TestbedInterface", "load_driver"]
