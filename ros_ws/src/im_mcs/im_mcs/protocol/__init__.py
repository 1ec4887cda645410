"""Shared parts of node and servo process: requests, channel, samples, heartbeats."""
