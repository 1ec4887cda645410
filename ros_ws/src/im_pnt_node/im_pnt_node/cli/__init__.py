"""Command ``journal`` of ``pnt``."""
