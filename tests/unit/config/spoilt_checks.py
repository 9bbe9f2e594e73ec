"""The same for the tables of the self-check, of the inclinometer, of maintenance and of proof on the wires.

A case is as in ``spoilt.py``. Every key of these tables is in one: wrong, out of range, missing.
"""

from __future__ import annotations

_DRIVER = '[inclinometer]\ndriver = "balluff_bsi_r11a0"\n'
_DEVICE = '"/dev/ttyUSB1"'
_ROLL = "max_roll_deg = 30.0"
_CHECK = "[self_check]\n"
_HOUSING = '[[thermometers]]\ndriver = "hwmon"\nname = "housing"\nchip = "tmp102"\n'
_DUE = "calibration_due_days = 180.0"


def _of_check(key: str, value: str, words: str) -> tuple[str, str, str, str]:
    """A case of ``[self_check]``."""
    return (_CHECK, f"{_CHECK}{key} = «{value}\n", f"self_check.{key}", words)


def _of_roll(key: str, value: str, words: str) -> tuple[str, str, str, str]:
    """A case of ``[inclinometer]``."""
    return (_ROLL, f"{_ROLL}\n{key} = «{value}", f"inclinometer.{key}", words)


def _of_maintenance(key: str, value: str, words: str) -> tuple[str, str, str, str]:
    """A case of ``[maintenance]``."""
    return (_DUE, f"{_DUE}\n{key} = «{value}", f"maintenance.{key}", words)


_LIMITS_MM_DEG = "possible: number above 0 to 10"

CASES: tuple[tuple[str, str, str, str], ...] = (
    # [self_check]
    _of_check("enabled", "2", "2 is neither true nor false; possible: true or false"),
    _of_check("interval_s", "true", "true is not a number"),
    _of_check("interval_s", "nan", "nan is not a finite number"),
    _of_check("interval_s", "9.9", "9.9 is too small; possible: number from 10 to 86400"),
    _of_check("interval_s", "86401", "86401 is too large"),
    _of_check("exposures", "1", "1 is too small; possible: whole number from 2 to 20"),
    _of_check("exposures", "21", "21 is too large"),
    _of_check("exposures", "4.5", "4.5 is not a whole number"),
    _of_check("exposures", "true", "true is not a number"),
    _of_check(
        "exposures", '"4"', '"4" is text; possible: whole number from 2 to 20; write it without quotes'
    ),
    _of_check("enabled", '"true"', '"true" is text; possible: true or false; write it without quotes'),
    _of_check("enabled", "1", "1 is neither true nor false; possible: true or false"),
    _of_check("suspect_mm", "0", f"0 is too small; {_LIMITS_MM_DEG}"),
    _of_check("suspect_mm", "0.2", "0.2 is above bad_mm; possible: up to 0.1"),
    _of_check("suspect_mm", "inf", "inf is not a finite number"),
    _of_check("suspect_deg", "-0.01", f"-0.01 is too small; {_LIMITS_MM_DEG}"),
    _of_check("suspect_deg", "0.04", "0.04 is above bad_deg; possible: up to 0.03"),
    _of_check("bad_mm", "10.1", f"10.1 is too large; {_LIMITS_MM_DEG}"),
    _of_check("bad_mm", '"0.1 mm"', '"0.1 mm" is not a number'),
    _of_check("bad_deg", "11", "11 is too large"),
    _of_check("bad_deg", "[]", "a list is not a number"),
    _of_check(
        "when_bad", '"invlid"', '"invlid" is not possible; possible: "invalid" or "warning"; did you mean'
    ),
    _of_check("when_bad", '"ignore"', 'possible: "invalid" or "warning"'),
    _of_check("when_unknown", "false", 'false is not possible; possible: "invalid" or "warning"'),
    _of_check("when_unknown", '"good"', '"good" is not possible'),
    _of_check("compensate", "0.5", "0.5 is neither true nor false"),
    _of_check("compensate_mm", "0.0", f"0.0 is too small; {_LIMITS_MM_DEG}"),
    _of_check("compensate_mm", "100", "100 is too large"),
    (_CHECK, f"{_CHECK}«intervall_s = 60\n", "self_check.intervall_s", "did you mean `interval_s`?"),
    ("[self_check]", "«[selfcheck]", "selfcheck", "there is no such table; possible: "),
    # [inclinometer]
    (
        _DRIVER,
        "«[inclinometer]\n",
        "inclinometer.driver",
        'this key is missing; possible: "balluff_bsi_r11a0" or',
    ),
    (f"device = {_DEVICE}\n", "", "inclinometer.device", "this key is missing; possible: path"),
    (_DEVICE, '«"ttyUSB1"', "inclinometer.device", '"ttyUSB1" is not the path of a device'),
    (_DEVICE, "«5", "inclinometer.device", "5 is not a path"),
    _of_roll("baud", "9601", "9601 is not possible; possible: 4800 or 9600 or 19200"),
    _of_roll("baud", '"19200"', '"19200" is text; possible: 4800 or 9600 or 19200'),
    _of_roll("parity", '"mark"', 'possible: "none" or "even" or "odd"'),
    _of_roll("stop_bits", "3", "3 is not possible; possible: 1 or 2"),
    _of_roll("stop_bits", "true", "true is not a number; possible: 1 or 2"),
    _of_roll("address", "0", "0 is too small; possible: whole number from 1 to 247"),
    _of_roll("address", "248", "248 is too large"),
    _of_roll("address", '"0x50"', '"0x50" is not a whole number'),
    _of_roll("interval_s", "0.01", "0.01 is too small; possible: number from 0.05 to 10"),
    _of_roll("interval_s", "11", "11 is too large"),
    (
        "max_age_s = 0.8",
        "max_age_s = «0.1",
        "inclinometer.max_age_s",
        "0.1 is too small; possible: number from 0.2",
    ),
    ("max_age_s = 0.8", "max_age_s = «61", "inclinometer.max_age_s", "61 is too large"),
    _of_roll("frozen_after_s", "0.1", "0.1 is too small; possible: number from 0.2 to 600"),
    _of_roll("frozen_after_s", "0.4", "0.4 is too short for readings each 0.15 s; possible: from 0.45"),
    _of_roll("frozen_after_s", "601", "601 is too large"),
    _of_roll("max_noise_deg", "0", "0 is too small; possible: number above 0 to 10"),
    _of_roll("max_noise_deg", "10.5", "10.5 is too large"),
    (_ROLL, "max_roll_deg = «0.0", "inclinometer.max_roll_deg", "0.0 is too small"),
    (_ROLL, 'max_roll_deg = «"30°"', "inclinometer.max_roll_deg", "is not a number"),
    _of_roll("sign_roll", "0", "0 is not possible; possible: -1 or 1"),
    _of_roll("sign_roll", "true", "true is not a number; possible: -1 or 1"),
    _of_roll("sign_pitch", '"-"', '"-" is not possible; possible: -1 or 1'),
    _of_roll("offset_roll_deg", "181", "181 is too large; possible: number from -180 to 180"),
    _of_roll("offset_roll_deg", "nan", "nan is not a finite number"),
    _of_roll("offset_pitch_deg", "-181.0", "-181.0 is too small"),
    _of_roll("max_divergence_deg", "0", "0 is too small; possible: number above 0 to 10"),
    _of_roll("max_divergence_deg", "12", "12 is too large"),
    (_ROLL, f"{_ROLL}\n«max_rol_deg = 3", "inclinometer.max_rol_deg", "did you mean `"),
    # [[thermometers]]
    (
        _HOUSING,
        _HOUSING.replace('"hwmon"', '«"hwmn"'),
        "thermometers.0.driver",
        '"hwmn" is not possible; possible: ',
    ),
    (_HOUSING, _HOUSING.replace('driver = "hwmon"\n', ""), "thermometers.0.driver", "this key is missing"),
    (_HOUSING, _HOUSING.replace('name = "housing"\n', ""), "thermometers.0.name", "this key is missing"),
    (
        _HOUSING,
        _HOUSING.replace('chip = "tmp102"\n', ""),
        "thermometers.0.chip",
        "this key is missing; possible: text",
    ),
    (
        _HOUSING,
        _HOUSING.replace('"housing"', '«"Housing"'),
        "thermometers.0.name",
        "characters that are not allowed",
    ),
    (_HOUSING, _HOUSING.replace('"tmp102"', '«""'), "thermometers.0.chip", '"" is too short'),
    (
        "channel = 2",
        "channel = «100",
        "thermometers.1.channel",
        "100 is too large; possible: whole number from 1",
    ),
    ("channel = 2", "channel = «2.5", "thermometers.1.channel", "2.5 is not a whole number"),
    ("channel = 2", "channel = 2\nmin_celsius = «-101", "thermometers.1.min_celsius", "-101 is too small"),
    ("channel = 2", "channel = 2\nmin_celsius = 60.0", "thermometers.1.max_celsius", ""),
    ("max_celsius = 55.0", "max_celsius = «201", "thermometers.0.max_celsius", "201 is too large"),
    ("max_celsius = 55.0", 'max_celsius = «"55 °C"', "thermometers.0.max_celsius", "is not a number"),
    # [maintenance]
    (_DUE, "calibration_due_days = «36501", "maintenance.calibration_due_days", "36501 is too large"),
    (
        _DUE,
        "calibration_due_days = «2026-11-21",
        "maintenance.calibration_due_days",
        "2026-11-21 is not a number",
    ),
    _of_maintenance("min_light_share", "1.0", "1.0 is too large; possible: number from 0 to below 1"),
    _of_maintenance("min_light_share", "-0.1", "-0.1 is too small"),
    _of_maintenance("max_dust_share", "0.0", "0 is too small; possible: number above 0 to 1"),
    _of_maintenance("max_dust_share", "1.5", "1.5 is too large"),
    _of_maintenance("max_residual_share", "0", "0 is too small; possible: number above 0 to 1"),
    _of_maintenance("max_residual_share", "1.1", "1.1 is too large"),
    _of_maintenance("max_residual_share", "{}", "a table is not a number"),
    (_DUE, f"{_DUE}\n«min_light = 0.5", "maintenance.min_light", "did you mean `min_light_share`?"),
    # proof and commands on the wires
    (
        "unit_id = 1",
        "unit_id = 1\nallow_self_check = «1.5",
        "modbus_tcp.allow_self_check",
        "neither true nor false",
    ),
    (
        "unit_id = 1",
        'unit_id = 1\nallow_self_check = «"local"',
        "modbus_tcp.allow_self_check",
        "neither true nor false",
    ),
    ("interval_s = 1.0", "interval_s = 1.0\nchecked = «3", "serial.0.checked", "3 is neither true nor false"),
    (
        'speaks = "console"',
        'speaks = "console"\n«checked = true',
        "serial.1.checked",
        'with speaks = "telegram"',
    ),
    (
        "port = 8080",
        "port = 8080\n«allow_self_check = true",
        "http.allow_self_check",
        "it is a key of [modbus_tcp]",
    ),
)
