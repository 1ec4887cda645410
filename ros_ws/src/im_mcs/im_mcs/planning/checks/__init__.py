"""What a motion is planned with, and whether it keeps to the limits and the tolerances."""
