"""Figures of the whole machine."""
