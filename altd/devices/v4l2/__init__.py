"""Video4Linux cameras: USB and MIPI (docs/cameras.md)."""
