"""Fiducial plates: codes, corners, poses."""

from im_vss.fiducial.finder import FiducialFit, find_fiducials

__all__ = ["FiducialFit", "find_fiducials"]
