"""How good the calibration is on synthetic data with known truth: against the Cramer-Rao bound and against OpenCV."""
