"""Settings of a unit, as a file."""


def unit_toml(serial: str, calibration: object, front: str, rear: str) -> str:
    """Settings of a unit with two targets; ``front`` and ``rear`` are the lines of the cameras' tables."""
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
