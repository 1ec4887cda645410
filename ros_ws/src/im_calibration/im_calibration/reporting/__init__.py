"""A calibration as report, pictures and files."""
