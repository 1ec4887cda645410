"""How well the light is found: RMS over its Cramer-Rao bound, saturated spots, false spots."""
