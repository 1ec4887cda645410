"""Poses of a wrist whose light is to be seen by cameras: for calibrations."""
