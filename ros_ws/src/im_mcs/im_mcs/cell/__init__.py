"""Cell files: the first one of a URDF, and checks of others."""
