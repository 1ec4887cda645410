"""Planning context of a motion, and checks of the limits and tolerances."""
