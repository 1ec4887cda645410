"""Client interface layer (paper, section 4): requests of clients, checked before any effect."""

from im_mcs.client.points import ordered_points

__all__ = ["ordered_points"]
