"""Petri nets as their authors wrote them, and what execution and analysis count with."""
