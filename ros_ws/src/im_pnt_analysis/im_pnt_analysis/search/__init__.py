"""Explicit search of reachable markings."""
