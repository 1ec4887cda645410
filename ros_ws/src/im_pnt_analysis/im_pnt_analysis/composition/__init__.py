"""Several nets as one, with the environment."""
