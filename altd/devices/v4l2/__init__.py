"""Cameras of the kernel's Video4Linux: USB and MIPI (docs/cameras.md)."""
