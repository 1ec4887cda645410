"""The Vision Services System (paper, section 5)."""
