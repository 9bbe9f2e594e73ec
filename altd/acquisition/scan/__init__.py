"""The calibration scan: the stage moves, the cameras record."""
