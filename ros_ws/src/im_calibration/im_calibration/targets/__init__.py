"""Calibration targets: geometry, and points in images."""
