"""Pure: frames of one instant, windows, means, and the calibration they are measured with."""
