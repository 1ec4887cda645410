"""Straight-line motion of the wrist (paper, section 4)."""
