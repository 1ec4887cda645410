"""Cell files: the first one from a URDF, and what one leaves open."""
