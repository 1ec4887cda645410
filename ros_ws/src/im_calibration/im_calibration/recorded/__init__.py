"""Recorded images and poses: bags, videos, trajectories."""
