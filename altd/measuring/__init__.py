"""Pure code: frame sets, windows, means, and the calibration that they are measured with."""
