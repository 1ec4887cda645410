"""Figures of the Data Object Manager."""
