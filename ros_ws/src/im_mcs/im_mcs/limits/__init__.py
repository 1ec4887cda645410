"""Limits and configuration of MCS: what everything else keeps to."""
