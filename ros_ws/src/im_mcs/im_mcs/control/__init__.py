"""Motion control layer (paper, section 4): setpoints and measured positions to commands, every servo tick."""

from im_mcs.control.controller import ControlInput, Controller, ControllerSetup
from im_mcs.control.guard import load_controller
from im_mcs.control.laws import ControlLaws
from im_mcs.control.source import LawSource

__all__ = ["ControlInput", "ControlLaws", "Controller", "ControllerSetup", "LawSource", "load_controller"]
