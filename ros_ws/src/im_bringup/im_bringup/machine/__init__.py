"""A machine as a whole: its start, phase by phase, its record while it runs, its stop, and what a killed one leaves."""
