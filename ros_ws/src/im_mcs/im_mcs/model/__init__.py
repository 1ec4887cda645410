"""Kinematics and dynamics of the cell as modelled by MCS, and the command to print both."""

from im_mcs.model.dynamics import CellModel, jacobian_of
from im_mcs.model.payload import ControlledModel, Payload

__all__ = ["CellModel", "ControlledModel", "Payload", "jacobian_of"]
