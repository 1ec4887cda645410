"""What commands print of a calibration: the report in short, and the true error."""
