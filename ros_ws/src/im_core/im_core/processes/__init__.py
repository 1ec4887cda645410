"""Processes of the machine: children, the start-up by phases, signals, scheduling, memory, and proof that they live."""
