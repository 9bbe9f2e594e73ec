"""The Active Laser Target: one beam through two or more targets."""
