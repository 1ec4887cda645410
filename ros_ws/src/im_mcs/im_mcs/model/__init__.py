"""Kinematics and dynamics of the cell in the eyes of MCS, and the command that prints them."""

from im_mcs.model.dynamics import Model
from im_mcs.model.payload import ControlledModel, Payload

__all__ = ["ControlledModel", "Model", "Payload"]
