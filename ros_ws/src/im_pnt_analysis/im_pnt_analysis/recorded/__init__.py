"""Nets out of recordings: the firings of a bag, and the markings at any moment of the recording."""
