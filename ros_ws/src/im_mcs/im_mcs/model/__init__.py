"""Kinematics and dynamics of the cell in the eyes of MCS, and the command that prints them."""

from im_mcs.model.dynamics import CellModel
from im_mcs.model.payload import ControlledModel, Payload

__all__ = ["CellModel", "ControlledModel", "Payload"]
