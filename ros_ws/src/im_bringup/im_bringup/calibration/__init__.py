"""Output of commands about a calibration: a short report, and the true error."""
