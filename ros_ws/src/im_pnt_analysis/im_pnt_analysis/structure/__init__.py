"""What the arcs of a net tell without a search: semiflows, siphons, traps, bounds, reductions."""
