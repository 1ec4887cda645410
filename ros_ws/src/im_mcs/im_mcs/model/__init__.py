"""Kinematics and dynamics of the cell in the eyes of MCS, and the command that prints them."""

from im_mcs.model.dynamics import Model

__all__ = ["Model"]
