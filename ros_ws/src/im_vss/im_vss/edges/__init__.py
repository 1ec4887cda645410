"""Edges in images: straight lines and circles, fitted to the pixels with the noise."""

from im_vss.edges.circles import CircleGates, EllipseFit, find_circles
from im_vss.edges.lines import LineFit, LineGates, find_lines

__all__ = ["CircleGates", "EllipseFit", "LineFit", "LineGates", "find_circles", "find_lines"]
