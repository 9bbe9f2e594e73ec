"""The calibration scan: the stage moves the beam, the cameras record."""
