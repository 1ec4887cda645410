"""Playing nets: with imagined actions, or along a given firing sequence."""
