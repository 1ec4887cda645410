"""What commands print of a calibration: its progress, its report in short, and its true error."""
