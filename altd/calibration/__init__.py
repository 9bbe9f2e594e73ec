"""Calibration of a unit from recordings, and the calibration file."""
