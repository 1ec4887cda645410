"""Layered drawings of nets."""
