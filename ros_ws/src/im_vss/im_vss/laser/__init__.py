"""The laser scanner: the driver, the calibration, and the evaluation of images of the lines."""
