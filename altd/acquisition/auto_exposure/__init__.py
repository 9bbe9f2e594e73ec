"""The next exposure and gain of a camera, and how they are applied."""
