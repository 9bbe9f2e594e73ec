"""The telegram: one measurement as two sentences with the framing of NMEA 0183, and a last one to check them.

One between them states sigma now, where the settings ask for it; one after them identifies the unit, rarely.

A sentence is ``$``, a name, fields after commas, ``*``, the exclusive or of all characters between ``$``
and ``*`` as two hexadecimal digits, CR LF; at most 82 characters in total. ``$P`` marks a proprietary
sentence. A value that is not known is an empty field. ``SENTENCES`` is the only definition of the fields:
the writer and ``docs/telegram.md`` follow it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, date, time
from functools import reduce
from operator import xor
from types import SimpleNamespace
from typing import Any

from altd.config import TelegramPortSettings
from altd.publish.serial.fields import CODES, MODE, UTC_TIME, Form, Mode, integer, number, text
from altd.reasons import Reason
from altd.records import Measurement
from altd.status.proof import Stamp, crc32

MAX_SENTENCE_BYTES = 82
"""Maximum number of characters from ``$`` to LF in NMEA 0183."""

LINE_END = b"\r\n"
SEQUENCE_MODULUS = 1 << 32
DOES_NOT_FIT = "does_not_fit"
MORE = "more"

MILLIMETRES = number(4, 3, signed=True)
DEGREES = number(2, 4, signed=True)
SIGMA_MILLIMETRES = number(2, 4, signed=False)
SIGMA_DEGREES = number(1, 4, signed=False)
SEQUENCE = integer(SEQUENCE_MODULUS - 1)


class TelegramError(ValueError):
    """A telegram that cannot be written; ``field`` names the field."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


@dataclass(frozen=True, slots=True, kw_only=True)
class Telegram:
    """The content of one telegram; None is an empty field."""

    time: time | None = None
    mode: Mode = Mode.INVALID
    sequence: int | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    frames: int | None = None
    sigma_x_mm: float | None = None
    sigma_y_mm: float | None = None
    sigma_yaw_deg: float | None = None
    sigma_pitch_deg: float | None = None
    reasons: tuple[str, ...] | None = None

    @classmethod
    def of(cls, measurement: Measurement | None) -> Telegram:
        """Return the content for the latest measurement; None: there is no measurement so far."""
        if measurement is None:
            return cls(reasons=(str(Reason.WARMING_UP),))
        head = cls(
            time=None if measurement.time is None else measurement.time.astimezone(UTC).timetz(),
            sequence=measurement.sequence % SEQUENCE_MODULUS,
        )
        codes = ordered_codes(measurement)
        numbers: dict[str, Any] = {key: measurement.number(key) for key in NUMBERS}
        numbers |= {f"sigma_{key}": measurement.sigma(key) for key in SIGMAS}
        full = replace(head, mode=mode_of(measurement), frames=measurement.frames, **numbers)
        try:
            return _with_codes(full, codes)
        except TelegramError:
            return _with_codes(head, (DOES_NOT_FIT, *codes))

    def encode(self) -> bytes:
        """Return both sentences; raises TelegramError when a value does not fit its field."""
        return b"".join(sentence.encode(self) for sentence in SENTENCES)


SIGMAS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
"""Keys of the quantities whose standard deviation is sent."""
NUMBERS = (*SIGMAS, "roll_deg")
"""Keys of the quantities that are sent."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field: the attribute of the content that it carries, its form, unit and meaning."""

    name: str
    form: Form
    unit: str
    meaning: str

    def text(self, content: object) -> str:
        """Text of the field, from the attribute of its name; raises TelegramError when it does not fit."""
        value = getattr(content, self.name)
        if value is None:
            return ""
        text = self.form.write(value)
        if not self.form.pattern.fullmatch(text):
            raise TelegramError(self.name, f"{value} does not fit {self.form.widest}")
        return text


@dataclass(frozen=True, slots=True)
class Sentence:
    """One sentence of the telegram: its name and its fields in order."""

    name: str
    title: str
    fields: tuple[Field, ...]

    def encode(self, content: object) -> bytes:
        """Return the sentence with checksum and line end; raises TelegramError when a value does not fit."""
        body = ",".join([self.name, *(field.text(content) for field in self.fields)]).encode("ascii")
        return b"$%s*%02X%s" % (body, checksum(body), LINE_END)


MEASUREMENT = Sentence(
    "PALTM",
    "the measurement",
    (
        Field("time", UTC_TIME, "hhmmss.sss", "UTC, middle of the averaged exposures; empty when not known"),
        Field("mode", MODE, "", "`A` valid, `V` invalid; `P` and `S` are not live, see below"),
        Field("sequence", SEQUENCE, "", "number of the last exposure; 0 follows the largest"),
        Field("x_mm", MILLIMETRES, "mm", "displacement to the right, seen along the beam"),
        Field("y_mm", MILLIMETRES, "mm", "displacement upwards"),
        Field("yaw_deg", DEGREES, "degree", "yaw, positive to the right"),
        Field("pitch_deg", DEGREES, "degree", "pitch, positive upwards"),
        Field("roll_deg", DEGREES, "degree", "roll; empty without an inclinometer"),
    ),
)

QUALITY = Sentence(
    "PALTQ",
    "its quality",
    (
        Field("sequence", SEQUENCE, "", "that of the `$PALTM` before it"),
        Field("frames", integer(9999), "", "exposures that were averaged"),
        Field("sigma_x_mm", SIGMA_MILLIMETRES, "mm", "standard deviation of x"),
        Field("sigma_y_mm", SIGMA_MILLIMETRES, "mm", "standard deviation of y"),
        Field("sigma_yaw_deg", SIGMA_DEGREES, "degree", "standard deviation of yaw"),
        Field("sigma_pitch_deg", SIGMA_DEGREES, "degree", "standard deviation of pitch"),
        Field("reasons", CODES, "", "reasons of an invalid measurement, warnings of a valid one"),
    ),
)

SENTENCES = (MEASUREMENT, QUALITY)


def checksum(body: Iterable[int]) -> int:
    """The exclusive or of the characters between ``$`` and ``*``."""
    return reduce(xor, body, 0)


def encode(measurement: Measurement | None) -> bytes:
    """Return the telegram of a measurement, written in one piece; None: nothing has been measured yet."""
    return Telegram.of(measurement).encode()


def _with_codes(telegram: Telegram, codes: tuple[str, ...]) -> Telegram:
    """Return the telegram with as many codes as fit; ``more`` replaces the others."""
    for kept in range(len(codes), -1, -1):
        shown = codes[:kept] + (MORE,) * (kept < len(codes))
        telegram = replace(telegram, reasons=shown or None)
        if len(QUALITY.encode(telegram)) <= MAX_SENTENCE_BYTES:
            break
    MEASUREMENT.encode(telegram)
    return telegram


def mode_of(measurement: Measurement) -> Mode:
    """Return whether the numbers may be used."""
    if not measurement.valid:
        return Mode.INVALID
    reasons = {fault.reason for fault in measurement.status}
    if Reason.SIMULATED in reasons:
        return Mode.SIMULATED
    return Mode.PLAYBACK if Reason.PLAYBACK in reasons else Mode.LIVE


def ordered_codes(measurement: Measurement) -> tuple[str, ...]:
    """Return reasons of the unit, of its targets, then warnings: the last are omitted if room is short."""
    ordered = sorted(measurement.status, key=lambda f: (f.reason.is_warning, f.target is not None))
    return tuple(dict.fromkeys(str(fault) for fault in ordered))


def _date(measurement: Measurement | None) -> date | None:
    """UTC date of the measurement's time."""
    if measurement is None or measurement.time is None:
        return None
    return measurement.time.astimezone(UTC).date()


OF_NOW = Sentence(
    "PALTN",
    "its uncertainty now",
    (
        Field("sequence", SEQUENCE, "", "that of the `$PALTM` before it"),
        *(
            Field(
                f"sigma_now_{key}",
                form,
                unit,
                f"standard deviation of {name} when sent; empty: not known",
            )
            for key, form, unit, name in (
                ("x_mm", SIGMA_MILLIMETRES, "mm", "x"),
                ("y_mm", SIGMA_MILLIMETRES, "mm", "y"),
                ("yaw_deg", SIGMA_DEGREES, "degree", "yaw"),
                ("pitch_deg", SIGMA_DEGREES, "degree", "pitch"),
            )
        ),
    ),
)


def of_now(measurement: Measurement | None, age_s: float | None) -> bytes:
    """Return the sentence with ``sigma_now``; one that is too large for its field is not known."""
    values: dict[str, float | int | None] = dict.fromkeys(field.name for field in OF_NOW.fields)
    if measurement is not None:
        values["sequence"] = measurement.sequence % SEQUENCE_MODULUS
    for key, field in zip(SIGMAS, OF_NOW.fields[1:], strict=True):
        value = None if measurement is None or age_s is None else measurement.sigma_at(key, age_s)
        if value is not None and field.form.pattern.fullmatch(field.form.write(value)):
            values[field.name] = value
    return OF_NOW.encode(SimpleNamespace(**values))


MAX_AGE_MS = 9_999_999
"""Maximum age that is sent, close to three hours; a greater age is sent as this value."""

_HEXADECIMAL = Form("FFFFFFFF", re.compile(r"[0-9A-F]{8}", re.ASCII), lambda value: f"{value:08X}")
_COUNT = integer(0xFFFF_FFFE)
_DATE = Form("20991231", re.compile(r"\d{8}", re.ASCII), lambda value: f"{value:%Y%m%d}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """Content of the sentence; None is an empty field."""

    unit: int | None = None
    session: int | None = None
    message: int | None = None
    clock_ms: int | None = None
    date: date | None = None
    age_ms: int | None = None
    crc32: int | None = None


PROOF = Sentence(
    "PALTC",
    "fields for the check of the telegram",
    (
        Field("unit", _HEXADECIMAL, "", "CRC-32 of the serial number"),
        Field("session", _HEXADECIMAL, "", "random at each start"),
        Field("message", _COUNT, "", "counts the telegrams of this port"),
        Field("clock_ms", _COUNT, "ms", "since the daemon started, at sending"),
        Field("date", _DATE, "yyyymmdd", "UTC, of `time` in `$PALTM`; empty when not known"),
        Field("age_ms", integer(MAX_AGE_MS), "ms", "since the middle of the exposures, at sending"),
        Field("crc32", _HEXADECIMAL, "", "of every character before it"),
    ),
)


def with_proof(telegram: bytes, measurement: Measurement | None, stamp: Stamp, age_s: float | None) -> bytes:
    """Return the telegram of a measurement with the sentence that proves it.

    The CRC covers all bytes from the first ``$`` of the telegram to the comma before the CRC, including line
    ends and checksums.
    """
    proof = Proof(
        unit=stamp.identity.unit,
        session=stamp.identity.session,
        message=stamp.message,
        clock_ms=stamp.clock_ms,
        date=_date(measurement),
        age_ms=None if age_s is None else min(max(round(1000 * age_s), 0), MAX_AGE_MS),
    )
    texts = [field.text(proof) for field in PROOF.fields[:-1]]
    begun = ",".join([f"${PROOF.name}", *texts, ""]).encode("ascii")
    return telegram + PROOF.encode(replace(proof, crc32=crc32(telegram + begun)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Nameplate:
    """Identity of the sending unit; None is an empty field."""

    unit: int | None
    serial: str
    firmware: str
    calibrated: date | None
    date: date | None = None
    """UTC date of the measurement before the sentence."""


IDENTIFICATION = Sentence(
    "PALTI",
    "which unit sends",
    (
        Field("unit", _HEXADECIMAL, "", "CRC-32 of the complete serial number in UTF-8, as in `$PALTC`"),
        Field("serial", text(26), "", "serial number, escaped as described below"),
        Field("firmware", text(16), "", "version of altd, escaped as described below"),
        Field("calibrated", _DATE, "yyyymmdd", "UTC date of the calibration"),
        Field("date", _DATE, "yyyymmdd", "UTC, of `time` in `$PALTM`; empty when not known"),
    ),
)


def identification(nameplate: Nameplate, measurement: Measurement | None) -> bytes:
    """Return the sentence that identifies the unit; it follows the telegram of the measurement."""
    return IDENTIFICATION.encode(replace(nameplate, date=_date(measurement)))


def longest_bytes(settings: TelegramPortSettings, of_measurement: int = len(SENTENCES)) -> int:
    """Maximum number of characters of a telegram with the sentences that a port sends."""
    sentences = of_measurement + settings.sigma_now + settings.checked
    sentences += settings.identify_every_s is not None
    return MAX_SENTENCE_BYTES * sentences
