"""What MCS does in figures: ``scripts/bench.sh --mcs``."""
