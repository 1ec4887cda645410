"""Trajectories: the pieces, and how they are followed, slowed down and stopped."""
