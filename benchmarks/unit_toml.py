"""The settings of a unit, as a file; nothing large is imported for it."""

from __future__ import annotations


def unit_toml(serial: str, calibration: object, front: str, rear: str) -> str:
    """A unit with two targets, each before a camera whose table has the lines ``front`` or ``rear``."""
    return f"""\
[unit]
serial = "{serial}"
calibration = "{calibration}"

[[targets]]
name = "front"
z_mm = 0.0
camera = "front"

[[targets]]
name = "rear"
z_mm = 280.0
camera = "rear"

[cameras.front]
{front}

[cameras.rear]
{rear}
"""
