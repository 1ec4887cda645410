"""Finding the light spot: difference of an LED-on and an LED-off frame, candidates, fit, decision."""

from im_vss.spot.finder import Finding, Region, SpotGates, find_spot
from im_vss.spot.fit import SpotFit, fit_spot
from im_vss.spot.noise import SensorNoise

__all__ = ["Finding", "Region", "SensorNoise", "SpotFit", "SpotGates", "find_spot", "fit_spot"]
