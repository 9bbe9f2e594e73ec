"""Check whether camera and target still have the same relative position as at calibration (thesis 3.4)."""
