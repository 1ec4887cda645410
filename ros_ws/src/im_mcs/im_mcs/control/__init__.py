"""Motion control layer (paper, section 4): setpoints and measured positions to torques, every servo tick."""

from im_mcs.control.controller import ControlInput, Controller, ControllerSetup, load_controller

__all__ = ["ControlInput", "Controller", "ControllerSetup", "load_controller"]
