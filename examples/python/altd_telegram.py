"""Reads the serial telegram of an Active Laser Target (``docs/telegram.md``), for programs that receive it.

It needs the standard library alone: copy this file::

    reader = Reader(unit="ALT-0007")
    while True:
        for reading in reader.feed(port.read(256)):
            if reading.valid:
                steer(reading.x_mm, reading.y_mm, reading.yaw_deg, reading.pitch_deg)

Use the numbers of a reading that is ``valid``, and no others. A silent line gives no reading: the program
needs a time-out of its own. Begin with an empty receive buffer, because an old telegram that waited there
looks fresh.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date, datetime, time
from functools import reduce
from operator import xor
from time import monotonic
from typing import Any, NamedTuple

_MAX_SENTENCE_BYTES = 82
_MODULUS = 0xFFFF_FFFF  # of message and clock_ms: 0xFFFFFFFE is followed by 0
_CLOCK_TOLERANCE = 0.0002  # share of the elapsed time by which two clocks may differ


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One telegram. None: an empty field; with a ``fault`` the numbers of the beam are None."""

    mode: str
    """``A`` live, ``V`` invalid; ``P`` (played) and ``S`` (simulated) are never valid."""
    fault: str = ""
    """Why the reader refuses the telegram; empty: it is accepted.

    ``foreign``: of another unit. ``unchecked``: without the third sentence. ``restarted``: of another
    session, see ``Reader.restart``. ``not newer``: repeated, or older than the previous one. ``late``: older
    than ``max_age_s``.
    """
    sequence: int | None = None
    """Number of the last exposure; the same number again is the same measurement."""
    time: time | None = None
    """UTC, middle of the averaged exposures."""
    x_mm: float | None = None
    y_mm: float | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    frames: int | None = None
    """Number of averaged exposures."""
    sigma_x_mm: float | None = None
    sigma_y_mm: float | None = None
    sigma_yaw_deg: float | None = None
    sigma_pitch_deg: float | None = None
    sigma_now_x_mm: float | None = None
    """Sigma at the moment of sending, where the port has ``sigma_now = true``; only with ``unit``."""
    sigma_now_y_mm: float | None = None
    sigma_now_yaw_deg: float | None = None
    sigma_now_pitch_deg: float | None = None
    reasons: tuple[str, ...] = ()
    """Codes: why the telegram is invalid, or its warnings."""
    session: int | None = None
    """Session; this field and those below are from the third sentence."""
    message: int | None = None
    clock_ms: int | None = None
    date: date | None = None
    """UTC date of ``time``."""
    age_ms: int | None = None
    """Time from the middle of the exposures until the unit sent the telegram, ms."""

    @property
    def valid(self) -> bool:
        """Whether the numbers may be used: they are live, and the telegram has no fault."""
        return self.mode == "A" and not self.fault


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Content of the sentence ``$PALTI`` about the sending unit; None: an empty field."""

    unit: int | None
    """CRC-32 of the complete serial number."""
    serial: str | None
    firmware: str | None
    calibrated: date | None
    date: date | None
    """UTC date of ``time`` in the telegram before it."""

    @property
    def is_whole(self) -> bool:
        """Whether ``serial`` is complete; a long serial number is sent without its end."""
        return self.serial is not None and _unit_number(self.serial) == self.unit


class Reader:
    """Converts bytes into readings.

    ``unit``: serial number of the unit, whose port has ``checked = true``. The reader then refuses another
    unit, another session, and telegrams older than ``max_age_s`` including all measured delays. None: it
    ignores the third sentence and detects none of these, which suffices for a display but not for a control.
    ``clock``: seconds of a clock that is never set.
    """

    def __init__(
        self, unit: str | None = None, max_age_s: float = 1.0, clock: Callable[[], float] = monotonic
    ) -> None:
        self.damaged = 0
        """Number of lines without an intact sentence, and of telegrams without one of their sentences."""
        self.lost = 0
        """Number of lost telegrams, as far as ``message`` shows. Only with ``unit``."""
        self.identity: Identity | None = None
        """The sending unit, once its port has identified it."""
        self._unit = None if unit is None else _unit_number(unit)
        self._max_age_s = max_age_s
        self._clock = clock
        self.restart()

    def restart(self) -> None:
        """Accept the next telegram as the first one.

        Until this is called, the reader refuses a unit that was restarted, because a replay of an old
        recorded session looks the same. Call it from the start procedure of the machine.
        """
        self._rest = b""
        self._begun: list[tuple[bytes, dict[str, Any]]] = []
        self._last: Mapping[str, Any] | None = None
        self._received_s = 0.0
        self._delay_s = 0.0

    def feed(self, data: bytes) -> list[Reading]:
        """Return the readings that these bytes complete; the bytes may be cut anywhere."""
        now_s = self._clock()
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-_MAX_SENTENCE_BYTES:]  # anything longer is not a sentence
        return [reading for line in lines if (reading := self._take(line + b"\n", now_s))]

    def _take(self, line: bytes, now_s: float) -> Reading | None:
        """Return the reading that this line completes, or whose missing end it reveals."""
        garbage, dollar, rest = line.rpartition(b"$")
        if garbage:
            self._drop(is_damaged=True)
        sentence = dollar + rest
        name, fields = _decoded(sentence)
        if not name:
            return self._drop(is_damaged=not garbage and line != b"\r\n")
        if name == "PALTN" and len(self._begun) == 2:  # the CRC-32 covers it with the sentence before it
            quality, of_quality = self._begun[1]
            if fields.pop("sequence") != of_quality["sequence"]:
                return self._drop()
            self._begun[1] = quality + sentence, of_quality | fields
            return None
        cut_short = self._end(now_s) if name != _ORDER[len(self._begun)] else None
        if name == "PALTI":
            self.identity = Identity(**fields)
        elif name == _ORDER[len(self._begun)]:
            self._begun.append((sentence, fields))
            if len(self._begun) == (2 if self._unit is None else 3):
                return self._end(now_s)
        return cut_short

    def _drop(self, *, is_damaged: bool = False) -> Reading | None:
        """Discard the incomplete telegram; returns no reading."""
        self.damaged += is_damaged or bool(self._begun)
        self._begun = []
        return None

    def _end(self, now_s: float) -> Reading | None:
        """Return the reading of a complete telegram, or of one whose next sentence is missing."""
        fields = self._joined() if len(self._begun) > 1 else None
        if fields is None:
            return self._drop()
        if self._unit is None:
            fault = self._disorder(fields)
        else:
            fault = self._fault(fields, now_s) if "crc32" in fields else "unchecked"
        self._begun = []
        return _reading(fields, fault)

    def _joined(self) -> dict[str, Any] | None:
        """Return the fields of all sentences; None if they contradict each other or the CRC-32."""
        (measured, of_measured), (quality, of_quality), *proofs = self._begun
        fields = of_measured | of_quality
        for proof, of_proof in proofs:
            if zlib.crc32(measured + quality + proof[: proof.rindex(b",") + 1]) != of_proof["crc32"]:
                return None
            fields |= of_proof
        given = {fields[key] is not None for key in _FILLED_WHEN_VALID}
        if fields["mode"] == "V":
            agrees = given == {False}
        else:
            agrees = given == {True} and None not in (fields["sequence"], fields["frames"])
        if fields["mode"] == "A":
            agrees &= _NOT_LIVE.isdisjoint(fields["reasons"] or ())
        return fields if agrees and of_measured["sequence"] == of_quality["sequence"] else None

    def _disorder(self, fields: Mapping[str, Any]) -> str:
        """Return the fault of a telegram whose third sentence is ignored."""
        if fields["sequence"] is None:
            return ""
        if self._last is not None:
            ahead = (fields["sequence"] - self._last["sequence"]) % 2**32
            if ahead >= 2**31 or (ahead == 0 and fields["mode"] != "V"):
                return "not newer"
        self._last = fields
        return ""

    def _fault(self, fields: Mapping[str, Any], now_s: float) -> str:
        """Return the first check of ``docs/proof.md`` after the CRC-32 that a telegram fails."""
        if fields["unit"] != self._unit:
            return "foreign"
        if (last := self._last) is not None:
            if fields["session"] != last["session"]:
                return "restarted"
            ahead = (fields["message"] - last["message"]) % _MODULUS
            if not 0 < ahead < _MODULUS // 2:
                return "not newer"
            self.lost += ahead - 1
            unit_s = (fields["clock_ms"] - last["clock_ms"]) % _MODULUS / 1000
            own_s = (now_s - self._received_s) * (1 - _CLOCK_TOLERANCE)
            self._delay_s = max(0.0, self._delay_s + own_s - unit_s)
        self._last, self._received_s = fields, now_s
        age_ms = fields["age_ms"]
        is_late = age_ms is None or age_ms / 1000 + self._delay_s > self._max_age_s
        return "late" if is_late and fields["mode"] != "V" else ""


def _reading(fields: Mapping[str, Any], fault: str) -> Reading:
    withheld = {*_FILLED_WHEN_VALID, "roll_deg", *_OF_NOW} if fault else set()
    known = {key: fields[key] for key in fields.keys() - withheld - {"unit", "crc32"}}
    return Reading(**known | {"fault": fault, "reasons": fields["reasons"] or ()})


def _unit_number(serial: str) -> int:
    return min(zlib.crc32(serial.encode()), _MODULUS - 1)


def _decoded(line: bytes) -> tuple[str, dict[str, Any]]:
    """Return the name and the fields of a sentence; ``other``: another kind, empty: not intact."""
    body = line[1:-5]
    if len(line) > _MAX_SENTENCE_BYTES or line != b"$%s*%02X\r\n" % (body, reduce(xor, body, 0)):
        return "", {}
    name, *texts = body.decode("latin-1").split(",")
    if (kinds := _SENTENCES.get(name)) is None:
        return "other", {}
    fields: dict[str, Any] = dict.fromkeys(kinds)
    try:
        for (key, kind), text in zip(kinds.items(), texts, strict=True):
            if text or key in _NEVER_EMPTY:
                if not re.fullmatch(kind.form, text, re.ASCII):
                    return "", {}
                fields[key] = kind.read(text)
    except ValueError:
        return "", {}
    return name, fields


class _Kind(NamedTuple):
    """Format of a field, and its reader, which raises ValueError for meaningless text."""

    form: str
    read: Callable[[str], Any] = float


def _number(largest: int) -> _Kind:
    def read(text: str) -> int:
        if int(text) > largest:
            raise ValueError(text)
        return int(text)

    return _Kind(rf"\d{{1,{len(str(largest))}}}", read)


def _unescaped(text: str) -> str:
    """Remove escapes and the mark of a cut; raises ValueError for text that is not UTF-8."""
    escaped = text.removesuffix("~").encode("ascii")
    return re.sub(rb"\^(..)", lambda found: bytes.fromhex(found[1].decode()), escaped).decode()


_TIME = _Kind(r"\d{6}\.\d{3}", lambda text: datetime.strptime(f"{text}+0000", "%H%M%S.%f%z").timetz())
_DATE = _Kind(r"\d{8}", lambda text: datetime.strptime(text, "%Y%m%d").date())
_HEXADECIMAL = _Kind(r"[0-9A-F]{8}", lambda text: int(text, 16))
_TEXT = _Kind(r"(?:(?![$*,!\\^~])[ -~]|\^[0-9A-F]{2})+~?", _unescaped)
_MM, _DEGREES = _Kind(r"-?\d{1,4}\.\d{3}"), _Kind(r"-?\d{1,2}\.\d{4}")
_SEQUENCE, _COUNT = _number(0xFFFF_FFFF), _number(_MODULUS - 1)
_SENTENCES = {
    "PALTM": {"time": _TIME, "mode": _Kind("[APSV]", str), "sequence": _SEQUENCE}
    | dict.fromkeys(("x_mm", "y_mm"), _MM)
    | dict.fromkeys(("yaw_deg", "pitch_deg", "roll_deg"), _DEGREES),
    "PALTQ": {"sequence": _SEQUENCE, "frames": _number(9999)}
    | dict.fromkeys(("sigma_x_mm", "sigma_y_mm"), _Kind(r"\d{1,2}\.\d{4}"))
    | dict.fromkeys(("sigma_yaw_deg", "sigma_pitch_deg"), _Kind(r"\d\.\d{4}"))
    | {"reasons": _Kind(r"[a-z0-9_]+(\+[a-z0-9_]+)*", lambda text: tuple(text.split("+")))},
    "PALTN": {"sequence": _SEQUENCE}
    | dict.fromkeys(("sigma_now_x_mm", "sigma_now_y_mm"), _Kind(r"\d{1,2}\.\d{4}"))
    | dict.fromkeys(("sigma_now_yaw_deg", "sigma_now_pitch_deg"), _Kind(r"\d\.\d{4}")),
    "PALTC": dict.fromkeys(("unit", "session"), _HEXADECIMAL)
    | dict.fromkeys(("message", "clock_ms"), _COUNT)
    | {"date": _DATE, "age_ms": _number(9_999_999), "crc32": _HEXADECIMAL},
    "PALTI": {"unit": _HEXADECIMAL}
    | dict.fromkeys(("serial", "firmware"), _TEXT)
    | dict.fromkeys(("calibrated", "date"), _DATE),
}
_ORDER = ("PALTM", "PALTQ", "PALTC")
_NEVER_EMPTY = {"mode", "unit", "session", "message", "clock_ms", "crc32"}
_BEAM = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
_FILLED_WHEN_VALID = (*_BEAM, *(f"sigma_{key}" for key in _BEAM))
_OF_NOW = tuple(f"sigma_now_{key}" for key in _BEAM)
_NOT_LIVE = {"simulated", "playback"}
