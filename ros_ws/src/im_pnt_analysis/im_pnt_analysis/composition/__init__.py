"""Several nets as one, with what surrounds them."""
