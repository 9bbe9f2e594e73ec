"""Whether camera and target are still in the same relative position as in the calibration (thesis 3.4)."""
