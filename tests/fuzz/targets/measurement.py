"""Measurements of any finite numbers on every interface: foreign readers get the same, or nothing."""

import json
import math
import struct
from typing import Any, NoReturn

import pynmea2
from fuzz.served import measurements
from support.measurements import beam_of

from altd.files.documents import line_of
from altd.publish.http.stream import event
from altd.publish.modbus.registers import image
from altd.publish.serial.telegram import encode
from altd.publish.serial.words import measurement_text, watch_line
from altd.records import Measurement
from altd.status.measurement_json import as_object_now
from tools.pages.example import view_of

NAME = "measurement"
EXAMPLES = measurements


def check(example: Measurement) -> None:
    """Each interface says valid or not, the same numbers within its digits, and none where there are none."""
    _check_telegram(example)
    _check_registers(example)
    _check_json(example)
    text = measurement_text(example)
    assert ("  NOT VALID" in text.splitlines()) == (not example.valid)
    assert "nan" not in text
    watch_line(example)


def _check_telegram(measurement: Measurement) -> None:
    """As pynmea2 reads it: framing, check sum, fields (NMEA 0183)."""
    telegram = encode(measurement)
    assert telegram.endswith(b"\r\n")
    first, second = telegram.decode("ascii").removesuffix("\r\n").split("\r\n")
    for line in (first, second):
        assert len(line) + 2 <= 82
    for line in (first, second):
        pynmea2.parse(line, check=True)
    fields = [part.split("*")[0].split(",") for part in (first, second)]
    mode, numbers = fields[0][2], fields[0][4:8]
    sigmas = fields[1][3:7]
    if mode == "V":
        assert set(numbers + sigmas) == {""}
        assert fields[1][7] != ""
    else:
        assert beam_of(measurement) is not None
        beam = beam_of(measurement)
        for text, wanted, digits in (
            *zip(numbers[:2], (beam.x_mm, beam.y_mm), (3, 3), strict=True),
            *zip(numbers[2:], (beam.yaw_deg, beam.pitch_deg), (4, 4), strict=True),
        ):
            assert abs(float(text) - wanted) <= 0.51 * 10.0**-digits
    if not measurement.valid:
        assert mode == "V"


def _check_registers(measurement: Measurement) -> None:
    words = image(view_of(measurement, 0.5, 1))
    assert len(words) == 120
    assert all(0 <= word <= 0xFFFF for word in words)
    assert (words[0] & 1) == measurement.valid
    floats = struct.unpack(">15f", struct.pack(">30H", *words[20:50]))
    numbers = floats[:6] + floats[7:11]
    assert all(map(math.isfinite, numbers)) if measurement.valid else all(map(math.isnan, numbers))
    scaled = struct.unpack(">15i", struct.pack(">30H", *words[60:90]))
    beam_scaled = scaled[:6] + scaled[7:11]
    assert all((number == -(2**31)) == (not measurement.valid) for number in beam_scaled)


def _check_json(measurement: Measurement) -> None:
    line = line_of(as_object_now(measurement, 0.5))
    assert event(measurement, line) == f"id: {measurement.sequence}\ndata: {line}\n\n"
    read: dict[str, Any] = json.loads(line, parse_constant=_refuse)
    assert "\n" not in line
    assert read["valid"] == measurement.valid
    keys = "x_mm", "y_mm", "yaw_deg", "pitch_deg", "yaw_mm_per_m", "pitch_mm_per_m"
    numbers = [read[key] for key in keys]
    numbers += list(read["sigma"].values())
    assert all((number is None) == (not measurement.valid) for number in numbers)


def _refuse(text: str) -> NoReturn:
    raise AssertionError(f"{text} is no JSON")
