"""What simulated cells are really like."""

from support.fixtures import make_truth

__all__ = ["make_truth"]
