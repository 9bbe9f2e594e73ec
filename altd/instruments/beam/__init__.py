"""The Active Laser Target: one beam through two targets or more."""
