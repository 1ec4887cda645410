"""Client interface layer (paper, section 4): what may be asked for, checked before anything happens."""

from im_mcs.client.points import ordered_points
from im_mcs.client.requests import Request, parse_request

__all__ = ["Request", "ordered_points", "parse_request"]
