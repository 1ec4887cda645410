"""Trajectories: the pieces, and the following, slowing down and stopping."""
