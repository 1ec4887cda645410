"""Statements of the arcs of a net without a search: semiflows, siphons, traps, bounds, reductions."""
