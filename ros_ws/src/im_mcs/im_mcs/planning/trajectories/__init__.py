"""What a trajectory is, of which pieces it is made, and how it is followed, slowed down and stopped."""
