"""What commands print of a calibration: its report in short, and its true error."""
