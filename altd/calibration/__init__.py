"""From a recording to the calibration file, and back."""
