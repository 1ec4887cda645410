"""Client interface layer (paper, section 4): what may be asked for, checked before anything happens."""

from im_mcs.client.points import ordered_points

__all__ = ["ordered_points"]
