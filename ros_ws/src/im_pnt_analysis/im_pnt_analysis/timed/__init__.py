"""Timed nets: steady state of stochastic nets, expected durations of commands, delays fitted to measured runs."""
