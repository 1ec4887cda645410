"""State spaces too large to list, as decision diagrams."""
