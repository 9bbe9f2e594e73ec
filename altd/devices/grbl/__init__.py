"""An xy stage behind a Grbl 1.1 controller."""
