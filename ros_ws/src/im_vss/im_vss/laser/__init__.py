"""The laser scanner: its driver, its calibration, and what images of its lines say."""
