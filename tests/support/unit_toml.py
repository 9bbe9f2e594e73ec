"""The settings of a unit with a front and a rear target, as TOML; a test says what else its unit has."""

from pathlib import Path

TARGETS = (
    {"name": "front", "z_mm": 0.0, "camera": "front"},
    {"name": "rear", "z_mm": 280.0, "camera": "rear"},
)
"""Of every unit of the tests, for settings that are made without a file."""

ALL_FACES = """\
max_lag_ms = 10.0
[installation]
sign_y = -1
[modbus_tcp]
host = "127.0.0.1"
port = {port}
unit_id = 7
[http]
host = "127.0.0.2"
port = {port}
[[serial]]
device = "/dev/altd-none-0"
speaks = "telegram"
interval_s = 0.5
[[serial]]
device = "/dev/altd-none-1"
speaks = "modbus_rtu"
parity = "even"
[[serial]]
device = "/dev/altd-none-2"
speaks = "console"
[stage]
driver = "grbl"
device = "/dev/altd-none-3"
[scan]
columns = 5
"""
"""Further settings of a unit that plays, one of each table; its serial ports do not exist."""


def unit_toml(serial: str, calibration: object, front: str, rear: str, more: str = "") -> str:
    """``front`` and ``rear`` are the lines of the cameras' tables, ``more`` all further tables."""
    targets = "".join(
        f'[[targets]]\nname = "{target["name"]}"\nz_mm = {target["z_mm"]}\ncamera = "{target["camera"]}"\n\n'
        for target in TARGETS
    )
    return (
        f'[unit]\nserial = "{serial}"\ncalibration = "{calibration}"\n\n{targets}'
        f"[cameras.front]\n{front.strip()}\n\n[cameras.rear]\n{rear.strip()}\n\n{more}"
    )


def played_toml(calibration: object, recording: object, more: str = "") -> str:
    """A unit whose cameras play a recording again and again."""
    camera = f'driver = "recording"\npath = "{recording}"\nrepeat = true'
    return unit_toml("TEST-1", calibration, camera, camera, "[measuring]\nwindow = 4\n" + more)


def write_config(path: Path, calibration: Path, recording: Path, more: str = "") -> Path:
    """Write the settings of a unit that plays a recording."""
    path.write_text(played_toml(calibration, recording, more))
    return path
