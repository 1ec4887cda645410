"""What can be said of a net before it runs: bounds, deadlocks, dead transitions, invariants; alone or composed."""
