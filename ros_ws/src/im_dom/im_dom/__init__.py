"""The Data Object Manager (paper, section 6): stores and retrieves globally available data."""
