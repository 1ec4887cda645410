"""Input of a calibration: observations, known lengths, data sets."""
