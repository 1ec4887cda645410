"""Calibration targets: their geometry, and their points in images."""
