"""What a calibration starts from: observations, known lengths, data sets."""
