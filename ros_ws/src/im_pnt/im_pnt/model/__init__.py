"""Petri nets in the written form, and in the form of execution and analysis."""
