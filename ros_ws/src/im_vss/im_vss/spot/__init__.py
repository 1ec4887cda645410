"""Finding the light spot: difference of an LED-on and an LED-off frame, candidates, fit, decision."""

from im_vss.spot.finder import SearchDisc, SpotFinding, SpotGates, find_spot
from im_vss.spot.fit import SpotFit, fit_spot

__all__ = ["SearchDisc", "SpotFinding", "SpotFit", "SpotGates", "find_spot", "fit_spot"]
