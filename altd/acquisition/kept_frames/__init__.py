"""Frames of the last seconds: in memory, and on the disk after a fault or on request."""
