"""Poses of a wrist with the light in view of cameras: for calibrations."""
