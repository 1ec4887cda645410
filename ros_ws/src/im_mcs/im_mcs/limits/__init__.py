"""Limits and configuration of MCS: rules for everything else."""
